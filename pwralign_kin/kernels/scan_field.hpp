// The scan as a field: nearest oriented point around its surface, free and occluded space where a sensor origin is
// known.
#pragma once
#include "lanes.hpp"
#include <memory>

namespace pwr {

struct OrientedPoint {
    Vec p, n;
};

// The order of some points along a space-filling curve, which keeps neighbours next to each other; their box begins at
// `low` and is nowhere wider than `extent`.
std::vector<int> along_curve(const Vec *points, int64_t stride, int64_t count, Vec low, float extent);

// What a sensor saw, as an image of depths.
class DepthImage {
  public:
    static constexpr int free = 0, silent = 1, occluded = 2; // states of positions; silent: no ray came back

    // The image of `points` from the `sensor` towards them; its pixels are as wide as `pixel` at their mean range. What
    // is out of the picture of a whole scene is occluded, for it tells nothing of that; else silent. Occluded is also
    // what is beyond one of the `borders` of the picture: planes through the sensor, by their normals.
    DepthImage(const std::vector<Vec> &points, Vec sensor, float pixel, float tolerance, bool whole_scene,
               const std::vector<Vec> &borders);

    // States of positions at some `range` from the sensor in the direction `forward`, and so far to the right and down;
    // not `inside` are those that do not matter.
    IntLanes states(FloatLanes range, FloatLanes rightward, FloatLanes downward, IntLanes inside) const {
        const FloatLanes scale = focal / range, x = scale * rightward + width * .5f,
                         y = scale * downward + height * .5f;
        inside = inside & (range > 1e-6f) & (x >= 0) & (y >= 0) & (x < float(width)) & (y < float(height));
        const IntLanes pixels = __builtin_convertvector(y, IntLanes) * width + __builtin_convertvector(x, IntLanes);
        int pixel[lane_count];
        store_lanes(inside ? pixels : IntLanes{}, pixel);
        FloatLanes surface{};
        for (int l = 0; l < lane_count; ++l) surface[l] = depth[pixel[l]];
        const IntLanes answered = inside & (surface < silence), behind = range > surface + tolerance;
        const IntLanes seen = behind ? IntLanes{} + occluded : IntLanes{} + free;
        const IntLanes state = answered ? seen : inside ? IntLanes{} + silent : IntLanes{} + beside;
        IntLanes cut_off{};
        for (const Vec &n : borders) cut_off |= n.x * rightward + n.y * downward + n.z * range > 0;
        return cut_off ? IntLanes{} + occluded : state;
    }

    Vec forward, right, down;

  private:
    static constexpr float silence = 1e30f;
    std::vector<Vec> borders; // normals to the right, down and forward
    std::vector<float> depth;
    int width, height, beside;
    float focal, tolerance;
};

class ScanField {
  public:
    // Points and unit normals; cells of size `cell` hold the nearest point within `truncation`. With a sensor origin,
    // `depth_points` (the full-resolution cloud) decide which cells are occluded: those behind a return by more than
    // `tolerance`, out to `shadow` behind the surface. Cells before and behind nothing, where no ray came back, are
    // known to be free only to the extent of `unreturned`, in [0, 1], and not at all beyond one of the `borders` of
    // what the sensor looked at: planes through it, by their outward normals. Without an origin nothing is told apart.
    // `weights`, `areas` and `regions` are described at the members.
    ScanField(std::vector<Vec> points, std::vector<Vec> normals, std::vector<float> weights, std::vector<float> areas,
              std::vector<int> regions, float cell, float truncation, const Vec *sensor_origin,
              const std::vector<Vec> &depth_points, const std::vector<Vec> &borders, float pixel, float tolerance,
              float shadow, float unreturned, int threads);

    // The cell of a position; outside of the grid there is one that is silent and near to nothing.
    int cell_at(Vec p) const {
        const float x = (p.x - origin.x) * inverse, y = (p.y - origin.y) * inverse, z = (p.z - origin.z) * inverse;
        if (!(x >= 0 && y >= 0 && z >= 0 && x < nx && y < ny && z < nz)) return outside;
        return (int(x) * ny + int(y)) * nz + int(z);
    }
    // The same of some positions.
    IntLanes cells_at(const VecLanes &p) const {
        const FloatLanes x = (p.x - origin.x) * inverse, y = (p.y - origin.y) * inverse, z = (p.z - origin.z) * inverse;
        const IntLanes inside = (x >= 0) & (y >= 0) & (z >= 0) & (x < float(nx)) & (y < float(ny)) & (z < float(nz));
        const auto whole = [](FloatLanes v) { return __builtin_convertvector(v, IntLanes); };
        return inside ? (whole(x) * ny + whole(y)) * nz + whole(z) : IntLanes{} + outside;
    }
    // Four times the nearest point of the cell of each position, plus its state; negative without a point.
    __attribute__((always_inline)) IntLanes codes_at(const VecLanes &p) const {
        const IntLanes cell = cells_at(p);
        IntLanes code{};
        for (int j = 0; j < lane_count; ++j) code[j] = cells[cell[j]];
        if (beyond && any_lane(cell == outside)) return cell == outside ? nothing + states_beyond(p) : code;
        return code;
    }
    // Nearest point of a position's cell, -1 for none.
    int nearest(Vec p) const { return cells[cell_at(p)] >> 2; }

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
    void mark_unseen(const DepthImage &image, int threads);
    IntLanes states_beyond(const VecLanes &p) const {
        const VecLanes d = p - sensor;
        return beyond->states(dot(beyond->forward, d), dot(beyond->right, d), dot(beyond->down, d),
                              first_lanes(lane_count));
    }

    static constexpr int nothing = -4;        // code of a cell that no point is near to, but for its state
    std::shared_ptr<const DepthImage> beyond; // what is known outside of the grid, of a picture with an end

    float cell, inverse;
    Vec origin;
    int nx, ny, nz;
    int outside = 0;        // index of the cell for all that lies outside of the grid
    std::vector<int> cells; // codes
};

} // namespace pwr
