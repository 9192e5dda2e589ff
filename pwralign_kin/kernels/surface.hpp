// Sampling of part surfaces and their closest-sample grids.
#pragma once
#include "linalg.hpp"

namespace pwr {

// Indices of a subset in which no two points are nearer than `radius` (greedy, in the given order).
std::vector<int> thin(const Vec *points, int64_t count, float radius);

// Indices of `count` points, each the farthest from those before it; the first is the farthest from the mean.
std::vector<int> farthest_points(const Vec *points, int64_t available, int64_t count);

// For every cell of a grid the index of (nearly) the closest sample; `none` beyond `band` of every sample.
// Danielsson's vector propagation: sweeps that offer each cell the samples of its neighbours.
std::vector<uint16_t> closest_sample_grid(const Vec *samples, int64_t count, Vec origin, float cell, const int *dims,
                                          float band);
constexpr uint16_t none = 0xFFFF;

} // namespace pwr
