// Preparation of raw clouds: downsampling, local planes, orientation of normals.
#pragma once
#include "linalg.hpp"

namespace pwr {

// Mean of the points of each occupied cell, in the order of the cells; `counts` gets the points per cell.
std::vector<Vec> voxel_means(const Vec *points, int64_t count, float cell, std::vector<int> &counts,
                             std::vector<int> &cell_of_point);

// Of each cell the first `each` points in the given order, cell by cell; `cell_of_point` counts cells from 0.
std::vector<int> first_of_cells(const int *cell_of_point, const std::vector<int> &order, int cells, int each);

// The local plane at each point from its neighbours within `radius`: unit normal, mean, variances in ascending order,
// count.
struct LocalPlanes {
    std::vector<Vec> normal, mean, variances;
    std::vector<int> neighbours;
};
LocalPlanes local_planes(const Vec *points, int64_t count, float radius, int threads);

// The normals of an oriented surface as scans tell them, whose local planes mix all that faces the sensor within
// `radius`: the mean over sensors all around.
std::vector<Vec> apparent_normals(const Vec *points, const Vec *normals, int64_t count, float radius, int threads);

// The first of all equal ones among rows of three finite numbers, in their order.
std::vector<int64_t> first_occurrences(const double *rows, int64_t count);

// Where steps of one length end that lead from each point in so many directions, evenly around its tangential plane.
std::vector<Vec> steps_around(const Vec *points, const Vec *normals, int64_t count, double step, int directions);

// The `each` nearest of some points to every query, nearest first.
struct Neighbours {
    int each = 0;
    std::vector<int> point;
    std::vector<float> distance;
};
Neighbours nearest_neighbours(const Vec *points, int64_t count, const Vec *queries, int64_t asked, int k, int threads);

// Of the neighbourhoods of some of the points, each of the nearest `sizes` (ascending) with the point itself, the
// eigenvalues (ascending) of their scatter over its degrees of freedom: a plane takes three. In the order of sizes,
// then eigenvalues, then queries.
std::vector<double> neighbourhood_variances(const Vec *points, int64_t count, const Vec *queries, int64_t asked,
                                            const std::vector<int> &sizes, int threads);

// How open each point's positive normal side is: sum over directions of free * (direction . normal), by marching
// through the occupancy of the cloud. Negative: the normal points inwards.
std::vector<float> openness(const Vec *points, const Vec *normals, int64_t count, float cell, int threads);

// Connected components of the points under links of at most `radius`: a label (0, 1, ... by first point) per point.
std::vector<int> components(const Vec *points, int64_t count, float radius);

// The plane (nx, ny, nz, d) with the most oriented points within `tolerance`, from minimal samples of one oriented
// point, or zeros.
struct Plane {
    Vec normal;
    float offset;
    int64_t inliers;
};
Plane dominant_plane(const Vec *points, const Vec *normals, int64_t count, float tolerance, int trials, uint64_t seed);

} // namespace pwr
