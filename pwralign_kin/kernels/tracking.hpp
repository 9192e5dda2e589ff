// One model followed from frame to frame: few points, no field of the scan, no memory taken once the first frames have
// shown how much is needed.
#pragma once
#include "closest_parts.hpp"
#include <array>
#include <limits>

namespace pwr {

// Positions sorted into the cells of an unbounded grid by hashing; cleared in no time.
class HashedCells {
  public:
    explicit HashedCells(int most) {
        size_t size = 16;
        while (size < 2 * size_t(most)) size *= 2;
        keys.resize(size), heads.resize(size), stamps.assign(size, 0);
        next.resize(most);
    }
    void clear(float size) { cell = size, ++stamp; }
    // The last point put into the cell of p, or -1; `slot` is where it is or would be.
    int head(Vec p, size_t &slot) const { return head_at(coordinate(p.x), coordinate(p.y), coordinate(p.z), slot); }
    void put(size_t slot, Vec p, int point) {
        const uint64_t own = pack_cell(coordinate(p.x), coordinate(p.y), coordinate(p.z));
        next[point] = stamps[slot] == stamp ? heads[slot] : -1;
        keys[slot] = own, heads[slot] = point, stamps[slot] = stamp;
    }
    // Whether a point lies within `reach` (at most the cell size) of p.
    bool any_within(const Vec *points, Vec p, float reach) const;

  private:
    int64_t coordinate(float v) const { return int64_t(std::floor(v / cell)); }
    int head_at(int64_t x, int64_t y, int64_t z, size_t &slot) const {
        const uint64_t own = pack_cell(x, y, z);
        uint64_t mixed = own * 0x9E3779B97F4A7C15ull;
        slot = (mixed ^ (mixed >> 32)) & (keys.size() - 1);
        while (stamps[slot] == stamp && keys[slot] != own) slot = (slot + 1) & (keys.size() - 1);
        return stamps[slot] == stamp ? heads[slot] : -1;
    }
    std::vector<uint64_t> keys;
    std::vector<int> heads, next;
    std::vector<uint32_t> stamps;
    uint32_t stamp = 0;
    float cell = 1;
};

// A depth image as it comes: distances along the optical axis in units of `scale` m.
struct PinholeView {
    double fx, fy, cx, cy, skew, scale;
    Rigid camera; // in the scan frame, m
    int height, width;
};

struct TrackingFit {
    int iterations = 0;
    float rmse = 0; // of the matched points' distances
};

// How a configuration fits a frame.
struct TrackingJudgement {
    float noise = 0;     // robust standard deviation of the distances of points close to the model
    float tolerance = 0; // a point nearer to the model is explained
    float coverage = 0;  // share of the points that the model explains
    float agreement = 0; // the same of the points that are close to the model
    float visible = 0; // share of the surface facing the sensor that is not behind something else or outside the image
    float supported = 0; // share of the visible that is at a point of the frame
    float cost = 0;      // robust mean square of the points' distances, 1 far beyond the tolerance
};

// Distance within which points of a noise (standard deviation) are explained: beyond the noise, models are not exact.
inline float explained_within(float noise) { return std::clamp(4 * noise + .002f, .006f, .02f); }

class Tracking {
  public:
    // At most `points` points of a frame are used, one for each cell of size `cell`.
    Tracking(const Articulated &model, int points, float cell);

    // Begin a frame in which the model is expected at a configuration; what is farther than `margin` is not looked at.
    // Lengths are model diagonals about `centre` (m), `unit` is the diagonal (m), `sensor` (m) may be null.
    void expect(const Rigid &base, const double *values, const double *centre, double unit, const double *sensor,
                float margin);
    template <typename Number> void look(const Number *points, int64_t count);
    template <typename Number> void look(const Number *depth, const PinholeView &view);
    // Gauss-Newton with a Geman-McClure kernel whose scale shrinks from `sigma_first` to `sigma_last`, about a belief
    // of inverse covariance `expected` (6 + joints)^2 in the predicted configuration, for points of a `noise` (standard
    // deviation); joints that are `held` stay as they are.
    TrackingFit fit(Rigid &base, double *values, const Rigid &predicted, const double *predicted_values,
                    const double *expected, const uint8_t *held, float sigma_first, float sigma_last, float noise,
                    int iterations, double seconds);
    // Points are explained within `tolerance`, or, where that is 0, within what the noise of this frame allows. Fills
    // `explained` and the following.
    TrackingJudgement judge(const Rigid &base, const double *values, float tolerance);
    // Score changes of one variable (rotation vector and shift of the base, then joints) up to `range` to either side.
    void sweep(const Rigid &base, const double *values, int variable, double range, float sigma,
               std::vector<double> &changes, std::vector<float> &scores);

    // What speaks against each of `count` rows of joint values, from 0 to 2: the robust mean square of the points'
    // distances at the scale `tolerance`, and the share of the visible surface that the frame does not show. The rows
    // differ in joints that are `varied` only.
    void weigh(const Rigid &base, const double *values, int64_t count, const uint8_t *varied, float tolerance,
               float *against);

    const Articulated &model;
    std::vector<Vec> kept;           // the points of the frame that are used
    std::vector<double> information; // (6 + joints)^2 of the last iteration of `fit`, the belief included
    // Per joint, how far what is seen moves along its normals for each unit: root of the sum over parts of mean
    // squares.
    std::vector<double> levers;
    std::vector<float> explained, strays; // per part, points close to it that it explains and that it does not
    std::vector<float> visible, shown;    // per part, weight of its visible surface and of what the frame shows of that

  private:
    struct Bounds {
        int part;
        float radius;
        Vec centre; // of the sphere, as placed
    };
    void examine(Vec p);
    bool thin(float size, int most);
    void settle();
    void place(const Rigid &base, const double *values);
    void assign(const SplitPoints &points, float cap);
    bool meets(Vec p, int part, int sample, float cap, Vec &foot, Vec &n, float &cosine) const;
    bool faces_sensor(Vec p, Vec n, float cosine) const;
    bool is_hidden(Vec p) const;
    bool is_beyond_image(Vec p) const;
    void solve(const double *values, const uint8_t *held);
    struct Seen { // weights of a part's surface
        float facing = 0, hidden = 0, shown = 0;
        void add(const Seen &other) { facing += other.facing, hidden += other.hidden, shown += other.shown; }
    };
    Seen seen_of(int part, int samples) const;
    void change(const Rigid &base, const double *values, int variable, double by);

    static constexpr int range_pixels = 64;
    const int most_points;
    const float cell;
    std::vector<Rigid> T;
    std::vector<RigidF> F;
    std::vector<Bounds> bounds; // of the parts that have a surface
    std::vector<Normal> normal;
    std::vector<double> twists, H, step, right, reduced, off, swept, moved_weight;
    enum : uint8_t { at_lower = 1, at_upper, still };
    std::vector<uint8_t> stopped;             // joints that stand at a limit in one step, or are held
    std::vector<uint8_t> moved;               // parts that a sweep moves
    std::vector<int> seen_below, moved_parts; // parts with points: each and all below it, those that a joint moves
    // The frame.
    double centre[3] = {0, 0, 0}, unit = 1;
    float margin = 0;
    bool has_sensor = false, has_ranges = false, has_image = false;
    PinholeView image;   // where the frame is one
    RigidF image_camera; // its camera, about the centre in model diagonals
    Vec sensor{0, 0, 0}, low{0, 0, 0}, high{0, 0, 0};
    float view_axes[9] = {}, half_width = 1;
    std::vector<float> ranges; // nearest measured distance per pixel of a coarse image from the sensor
    struct Sum {
        Vec p;
        float count;
    };
    std::vector<Vec> candidates;
    std::vector<Sum> sums;              // of the candidates of each cell
    SplitPoints loose;                  // points that parts at rest do not explain
    std::array<SplitPoints, 3> thinner; // all points that are used, every so many, and fewer still
    std::vector<float> ordered, resting;
    std::vector<float> distance;    // of the points assigned last from the nearest part, ...
    std::vector<int> owner, sample; // ... which part that is, -1 for none, and its sample
    CloseSamples close;
    HashedCells thinned, near;
};

} // namespace pwr
