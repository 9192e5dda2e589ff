#include "ordering.hpp"
#include <numeric>

namespace pwr {

std::vector<int> descending(const std::vector<double> &keys, size_t most) {
    std::vector<int> order(keys.size());
    std::iota(order.begin(), order.end(), 0);
    most = std::min(most, order.size());
    std::partial_sort(order.begin(), order.begin() + most, order.end(),
                      [&](int a, int b) { return keys[a] != keys[b] ? keys[a] > keys[b] : a < b; });
    order.resize(most);
    return order;
}

} // namespace pwr
