// The scan as a field: nearest oriented point around its surface, free and occluded space where a sensor origin is known.
#pragma once
#include "linalg.hpp"

namespace pwr {

struct OrientedPoint {
    Vec p, n;
};

class ScanField {
  public:
    // Points and unit normals; cells of size `cell` hold the nearest point within `truncation`. With a sensor origin,
    // `depth_points` (the full-resolution cloud) decide which cells are occluded: those behind a return by more than
    // `tolerance`, out to `shadow` behind the surface.
    // `weights`, `areas` and `regions` are described at the members.
    ScanField(std::vector<Vec> points, std::vector<Vec> normals, std::vector<float> weights, std::vector<float> areas,
              std::vector<int> regions, float cell, float truncation, const Vec *sensor_origin,
              const std::vector<Vec> &depth_points, float pixel, float tolerance, float shadow, int threads);

    // Cell of a position, -1 outside of the grid.
    int64_t cell_at(Vec p) const {
        const float x = (p.x - origin.x) * inverse, y = (p.y - origin.y) * inverse, z = (p.z - origin.z) * inverse;
        if (x < 0 || y < 0 || z < 0 || x >= nx || y >= ny || z >= nz) return -1;
        return (int64_t(x) * ny + int64_t(y)) * nz + int64_t(z);
    }
    // Nearest point of a cell, -1 if none is within the truncation.
    int nearest(int64_t at) const { return index[at]; }
    bool is_occluded(int64_t at) const { return !occluded.empty() && occluded[at]; }

    std::vector<OrientedPoint> points;
    std::vector<float> weight; // how much a point speaks for a part that lies on it
    std::vector<float> area;   // surface that a point stands for, in any unit
    std::vector<int> region;   // points of one region are searched together; -1: known surface, not searched
    bool has_origin;
    Vec sensor;

  private:
    void splat(float truncation, int threads);
    void mark_occluded(const std::vector<Vec> &depth_points, float pixel, float tolerance, int threads);

    float cell, inverse;
    Vec origin;
    int nx, ny, nz;
    std::vector<int> index;
    std::vector<uint8_t> occluded;
};

} // namespace pwr
