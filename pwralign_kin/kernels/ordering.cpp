#include "ordering.hpp"
#include <algorithm>
#include <numeric>

namespace pwr {

std::vector<int> descending(const std::vector<double> &keys) {
    std::vector<int> order(keys.size());
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int a, int b) { return keys[a] != keys[b] ? keys[a] > keys[b] : a < b; });
    return order;
}

} // namespace pwr
