// The model as the kernels see it: kinematic tree of rigid parts and their surfaces. Lengths are in units of the
// model's diagonal.
#pragma once
#include "lanes.hpp"
#include "scan_field.hpp"
#include "surface.hpp"

namespace pwr {

// Pairs of oriented samples of one part, sorted by their feature (distance and three angles; Drost et al., CVPR 2010).
struct PairTable {
    static constexpr int angle_bins = 11; // 18 degrees each; the last catches exactly 180
    static constexpr float distance_bin = .02f;
    float shortest = 0, longest = 0;
    int distance_bins = 0;
    std::vector<uint64_t> pairs; // sorted: feature, first and second sample of each, in 32, 16 and 16 bits

    int feature(Vec p, Vec n, Vec q, Vec m) const;
    // Rotation (9) whose x axis is the normal and whose y axis leans to the second point; false where there is none.
    static bool pair_frame(Vec n, Vec direction, float *R);
    static uint64_t packed(int feature, int first, int second) {
        return uint64_t(feature) << 32 | uint64_t(first) << 16 | uint64_t(second);
    }
    static int first(uint64_t pair) { return int(pair >> 16 & 0xFFFF); }
    static int second(uint64_t pair) { return int(pair & 0xFFFF); }
};

struct Surface {
    bool exists = false;
    float size = 0, area = 0, weight = 0, radius = 0;
    Vec centre{0, 0, 0};
    std::vector<Vec> p, n;            // coarse samples, farthest first: any prefix is a coarse set
    std::vector<float> w, cumulated;  // weights of the coarse samples and of every prefix
    std::vector<OrientedPoint> dense; // samples that the grid refers to, ...
    OrientedRows dense_rows;          // ... and once more, for several at a time
    std::vector<Vec> apparent;        // their normals as a scan tells them
    std::vector<uint16_t> grid;       // closest dense sample per cell
    Vec grid_origin{0, 0, 0};
    float inverse = 1;                     // of the size of a cell
    float slack = 0;                       // tangential distance to the closest sample that means nothing
    float cell_slack = 0;                  // more of it, for a cell may name a sample that is not the closest: it
                                           // counts in what tells a joint; small parts are told apart without
    Vec middle{0, 0, 0}, half{0, 0, 0};    // of the box around all discs of radius `slack`
    SplitPoints lane_points, lane_normals; // the coarse samples once more, ...
    std::vector<float> lane_weights;       // ... for several at a time
    int dims[3] = {0, 0, 0};
    PairTable pairs;

    int count(int most) const { return std::min<int>(most, int(p.size())); }

    // Cells of the grid that hold some local positions; -1 outside of it.
    IntLanes cells_at(const VecLanes &local) const {
        const FloatLanes x = (local.x - grid_origin.x) * inverse, y = (local.y - grid_origin.y) * inverse,
                         z = (local.z - grid_origin.z) * inverse;
        const IntLanes inside =
            (x >= 0) & (y >= 0) & (z >= 0) & (x < float(dims[0])) & (y < float(dims[1])) & (z < float(dims[2]));
        const auto whole = [](FloatLanes v) { return __builtin_convertvector(v, IntLanes); };
        return inside ? (whole(x) * dims[1] + whole(y)) * dims[2] + whole(z) : IntLanes{} - 1;
    }
    // The dense sample that is closest to a local position, -1 where none is near.
    int sample_at(Vec local) const {
        const float x = (local.x - grid_origin.x) * inverse, y = (local.y - grid_origin.y) * inverse,
                    z = (local.z - grid_origin.z) * inverse;
        if (!(x >= 0 && y >= 0 && z >= 0 && x < float(dims[0]) && y < float(dims[1]) && z < float(dims[2]))) return -1;
        const uint16_t named = grid[(int64_t(x) * dims[1] + int64_t(y)) * dims[2] + int64_t(z)];
        return named == none ? -1 : int(named);
    }
    // Distance of a local position to a dense sample. The surface is taken as a disc of radius `slack` around each:
    // `aside` is how far beyond its rim the position lies.
    float distance_to(int sample, Vec local, float &aside) const {
        const Vec d = local - dense[sample].p;
        const float plane = dot(d, dense[sample].n);
        aside = std::max(0.f, std::sqrt(std::max(0.f, dot(d, d) - plane * plane)) - slack);
        return std::sqrt(plane * plane + aside * aside);
    }
    // Those of some positions to as many samples, the discs larger by `wider`.
    FloatLanes distances_to(const int *samples, const VecLanes &local, float wider) const {
        VecLanes place, normal;
        dense_rows.gather(samples, place, normal);
        const VecLanes d = local - place;
        const FloatLanes plane = dot(d, normal), nothing{};
        const FloatLanes aside =
            max_lanes(sqrt_lanes(max_lanes(dot(d, d) - plane * plane, nothing)) - (slack + wider), nothing);
        return sqrt_lanes(plane * plane + aside * aside);
    }
};

// How far a joint may be open (rad, length), and beyond its limits.
struct Tolerance {
    double turn, slide, beyond;
};

class Articulated {
  public:
    int parts = 0, joints = 0;
    std::vector<int> parent, actuated;
    std::vector<Rigid> placement; // of the joint frame in the parent part
    std::vector<double> axis, multiplier, offset;
    std::vector<uint8_t> prismatic;
    std::vector<double> lower, upper;
    std::vector<uint8_t> wraps;
    std::vector<Surface> surface;

    // Finish a surface whose samples and grid are set: prefix weights, box, lanes and pair table.
    void finish(Surface &s) const;
    // Placement of a part in its parent for an actuated value.
    Rigid joint_placement(int part, double value) const;
    void forward(const Rigid &base, const double *values, Rigid *T) const;
    // The same of `some` parts only, each after its parent unless that is the root.
    void forward(const Rigid &base, const double *values, const std::vector<int> &some, Rigid *T) const;
    // Whether `descendant` is `part` or below it.
    bool below(int descendant, int part) const {
        while (descendant > part) descendant = parent[descendant];
        return descendant == part;
    }
    // Change a joint's value, by `most` at most and within its limits; return by how much it was to change.
    double step_joint(int joint, double change, double most, double &value) const {
        change = std::clamp(change, -most, most);
        const double low = lower[joint], high = upper[joint];
        value += change;
        if (wraps[joint]) value -= (high - low) * std::floor((value - low) / (high - low));
        else value = std::clamp(value, low, high);
        return std::abs(change);
    }
    // Whether the joints of a chain (one part, or two of which the first has no surface) close between placements of
    // the part above it and of its last, and the actuated `values` that they then take, within the limits.
    bool close(const std::vector<int> &chain, const Rigid &above, const Rigid &below, const Tolerance &open,
               double *values) const;
    // World twist of a part's joint about the point c, (6).
    void joint_twist(int part, const Rigid *T, const double *c, double *twist) const;
    // Those of all parts, (parts, 6); the root's is zero.
    void joint_twists(const Rigid *T, const double *c, double *twists) const;
    // Add the normal equations of the parts to those of base and joints (6 + joints), accumulated from the leaves (as
    // in Featherstone's composite-rigid-body algorithm). Those of the base itself stay in normal[0], complete.
    void compose(Normal *normal, const double *twists, double *H, double *g) const;

  private:
    // The actuated value, within the limits, at which a part's joint has moved so far, and whether they allow it but
    // for `beyond`.
    bool actuated_by(int part, double motion, double beyond, double &value) const;
};

} // namespace pwr
