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

std::vector<int> sort_keys(std::vector<uint64_t> &keys) {
    std::vector<int> order(keys.size());
    std::iota(order.begin(), order.end(), 0);
    uint64_t any = 0, all = ~uint64_t(0);
    for (const uint64_t k : keys) any |= k, all &= k;
    std::vector<uint64_t> next_keys(keys.size());
    std::vector<int> next_order(keys.size());
    // Radix sort, byte by byte from the lowest. Bytes that all keys share are skipped.
    for (int shift = 0; shift < 64; shift += 8) {
        if (!(((any ^ all) >> shift) & 255)) continue;
        int64_t start[257] = {};
        for (const uint64_t k : keys) ++start[((k >> shift) & 255) + 1];
        for (int v = 0; v < 256; ++v) start[v + 1] += start[v];
        for (size_t i = 0; i < keys.size(); ++i) {
            const int64_t to = start[(keys[i] >> shift) & 255]++;
            next_keys[to] = keys[i], next_order[to] = order[i];
        }
        keys.swap(next_keys), order.swap(next_order);
    }
    return order;
}

} // namespace pwr
