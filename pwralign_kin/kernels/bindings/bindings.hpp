// What the module is made of.
#pragma once
#include <nanobind/nanobind.h>

namespace pwr {

void bind_clouds(nanobind::module_ &m);
void bind_model(nanobind::module_ &m);
void bind_meshes(nanobind::module_ &m);
void bind_field(nanobind::module_ &m);
void bind_search(nanobind::module_ &m);
void bind_mixture(nanobind::module_ &m);
void bind_tracking(nanobind::module_ &m);

} // namespace pwr
