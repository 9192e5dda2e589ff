// Python bindings: arrays in, arrays out. Lengths are in units of the model's diagonal.
#include "bindings/bindings.hpp"
#include <stdexcept>

NB_MODULE(_native, m) {
#if defined(__x86_64__) && defined(__AVX2__)
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma"))
        throw std::runtime_error("pwralign_kin was built for processors with AVX2 and FMA; rebuild it on this machine");
#endif
    pwr::bind_clouds(m);
    pwr::bind_model(m);
    pwr::bind_meshes(m);
    pwr::bind_field(m);
    pwr::bind_search(m);
    pwr::bind_mixture(m);
    pwr::bind_tracking(m);
}
