// Configurations in and out of the bindings.
#pragma once
#include "../search.hpp"
#include "arrays.hpp"
#include <algorithm>

namespace pwr {

inline std::vector<Configuration> read_configurations(const Articulated &model, const Placements &bases,
                                                      const Matrix &values) {
    require(bases.shape(0) == values.shape(0) && int(values.shape(1)) == model.joints,
            "bases (m, 4, 4) and values (m, k) do not match the model");
    std::vector<Configuration> out(bases.shape(0));
    for (size_t i = 0; i < out.size(); ++i)
        out[i] = {read_placement(bases.data() + 16 * i),
                  {values.data() + i * model.joints, values.data() + (i + 1) * model.joints}};
    return out;
}
inline nb::tuple write_configurations(const Articulated &model, const std::vector<Configuration> &configurations) {
    const size_t m = configurations.size(), k = model.joints;
    std::vector<double> bases(16 * m), values(k * m);
    std::vector<float> scores(m);
    for (size_t i = 0; i < m; ++i) {
        write_placement(configurations[i].base, &bases[16 * i]);
        std::copy(configurations[i].values.begin(), configurations[i].values.end(), values.begin() + k * i);
        scores[i] = configurations[i].score;
    }
    return nb::make_tuple(to_numpy(std::move(bases), {m, 4, 4}), to_numpy(std::move(values), {m, k}),
                          to_numpy(std::move(scores)));
}

} // namespace pwr
