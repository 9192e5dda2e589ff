// The scan as a field: nearest oriented point around its surface, free and occluded space where a sensor origin is known.
#pragma once
#include "lanes.hpp"

namespace pwr {

struct OrientedPoint {
    Vec p, n;
};

// The order of some points along a space-filling curve, which keeps neighbours next to each other; their box begins at `low`
// and is nowhere wider than `extent`.
std::vector<int> along_curve(const Vec *points, int64_t stride, int64_t count, Vec low, float extent);

class ScanField {
  public:
    // Points and unit normals; cells of size `cell` hold the nearest point within `truncation`. With a sensor origin,
    // `depth_points` (the full-resolution cloud) decide which cells are occluded: those behind a return by more than
    // `tolerance`, out to `shadow` behind the surface. Cells before and behind nothing, where no ray came back, are
    // known to be free only to the extent of `unreturned`, in [0, 1]; without an origin nothing is told apart.
    // `weights`, `areas` and `regions` are described at the members.
    ScanField(std::vector<Vec> points, std::vector<Vec> normals, std::vector<float> weights, std::vector<float> areas,
              std::vector<int> regions, float cell, float truncation, const Vec *sensor_origin,
              const std::vector<Vec> &depth_points, float pixel, float tolerance, float shadow, float unreturned,
              int threads);

    // The cell of a position; outside of the grid there is one that is silent and near to nothing.
    int cell_at(Vec p) const {
        const float x = (p.x - origin.x) * inverse, y = (p.y - origin.y) * inverse, z = (p.z - origin.z) * inverse;
        if (!(x >= 0 && y >= 0 && z >= 0 && x < nx && y < ny && z < nz)) return outside;
        return (int(x) * ny + int(y)) * nz + int(z);
    }
    // The cells of some positions.
    IntLanes cells_at(const VecLanes &p) const {
        const FloatLanes x = (p.x - origin.x) * inverse, y = (p.y - origin.y) * inverse, z = (p.z - origin.z) * inverse;
        const IntLanes inside = (x >= 0) & (y >= 0) & (z >= 0) & (x < float(nx)) & (y < float(ny)) & (z < float(nz));
        const auto whole = [](FloatLanes v) { return __builtin_convertvector(v, IntLanes); };
        return inside ? (whole(x) * ny + whole(y)) * nz + whole(z) : IntLanes{} + outside;
    }
    // Four times the nearest point of a cell, plus its state; negative without a point.
    int code(int cell) const { return cells[cell]; }
    // Nearest point of a position's cell, -1 for none.
    int nearest(Vec p) const { return cells[cell_at(p)] >> 2; }

    static constexpr int free = 0, silent = 1, occluded = 2; // states of cells; silent: no ray came back

    std::vector<OrientedPoint> points;
    OrientedRows rows;         // the points once more, for several at a time
    std::vector<int> curve;    // the points along a space-filling curve: neighbours next to each other
    std::vector<float> weight; // how much a point speaks for a part that lies on it
    std::vector<float> area;   // surface that a point stands for, in any unit
    std::vector<int> region;   // points of one region are searched together; -1: known surface, not searched
    float unreturned;          // how free silent cells are
    bool has_origin;
    Vec sensor;

  private:
    void splat(float truncation, int threads);
    void mark_unseen(const std::vector<Vec> &depth_points, float pixel, float tolerance, int threads);

    float cell, inverse;
    Vec origin;
    int nx, ny, nz;
    int outside = 0;        // index of the cell for all that lies outside of the grid
    std::vector<int> cells; // codes
};

} // namespace pwr
