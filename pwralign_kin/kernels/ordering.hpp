// Sorting, compiled once for all that carries a score or a key.
#pragma once
#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

namespace pwr {

// Indices of the `most` largest keys from the largest to the smallest, equal ones in the order given.
std::vector<int> descending(const std::vector<double> &keys, size_t most);

// Sort keys in ascending order; return where each of them was, equal ones in the order given.
std::vector<int> sort_keys(std::vector<uint64_t> &keys);

// Keep the `most` of best score, best first, equal ones in the order given.
template <typename Scored> void sort_by_score(std::vector<Scored> &items, size_t most = SIZE_MAX) {
    std::vector<double> scores;
    scores.reserve(items.size());
    for (const Scored &item : items) scores.push_back(item.score);
    std::vector<Scored> sorted;
    sorted.reserve(std::min(most, items.size()));
    for (int i : descending(scores, most)) sorted.push_back(std::move(items[i]));
    items = std::move(sorted);
}

} // namespace pwr
