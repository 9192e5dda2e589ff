// The search of one model in one scan: part hypotheses, growth through the tree, two-way score, batch refinement.
#pragma once
#include "articulated.hpp"
#include "closest_parts.hpp"
#include "parallel.hpp"
#include "prior.hpp"
#include "scan_field.hpp"
#include "seen_surface.hpp"
#include <map>
#include <mutex>

namespace pwr {

struct SearchOptions {
    // Scales, in units of the model's diagonal.
    float support_distance = .035f; // a sample nearer to the scan is supported
    float coverage_distance = .03f; // a scan point nearer to the model is covered
    float band = .06f;              // distances beyond it are all the same
    // Evidence.
    float free_penalty = .35f;     // of a sample in free space
    float occluded_penalty = .05f; // of a sample in occluded space
    float mismatch_penalty = .7f;  // share of the penalty for a visible sample on scan of another orientation
    float normal_penalty = .4f;    // of a covered point whose normal is at right angles to the model's
    float near_penalty = 0;        // of a point near the model that it does not cover
    float contested_penalty = .5f; // share of the free penalty for a sample that another part explains
    float support_weight = .6f;    // of model support against scan coverage
    float absent_floor = .15f;     // least support of a part, full scans
    bool solid = false;            // whether parts that are not joined may not be inside each other
    float overlap_penalty = 1.f;   // ... of all surface that is
    float coverage_scale = 1.f;    // number of scan points over the number that the model is expected to yield
    bool two_way = true;           // whether support counts at all
    // Growth.
    float angle_step = .1047198f;
    int beam = 24, modes = 10, branch_beam = 3;
    int sweep_samples = 48;
    float explained_weight = .3f; // weight of points that fixed parts explain already
    int threads = 1;
};

struct Hypothesis {
    int part;
    Rigid T;
    float score;
};

// A point of a part (part frame) and the scan point it is believed to be.
struct Correspondence {
    OrientedPoint source, target;
    float weight;
};

struct Configuration {
    Rigid base;
    std::vector<double> values;
    float score = 0;
};

// Two-way scores of some configurations.
struct Scores {
    std::vector<float> total, coverage;
    std::vector<float> support; // (configurations, parts)
};

struct Assignment {
    std::vector<float> distance;
    std::vector<int> part, sample; // -1 beyond the cap
};

// Some points, in the order of a sample and once more in that of their neighbourhood.
struct PointSample {
    std::vector<OrientedPoint> points;
    BalledPoints balled;
    OrientedRows rows; // in the order of their neighbourhood
    float weight = 0;  // of all of them together

    PointSample(std::vector<OrientedPoint> given, std::vector<int> order)
        : points(std::move(given)), balled(&points[0].p, 2, std::move(order)) {
        rows.reserve(points.size());
        for (const int i : balled.order) rows.push(points[i].p, points[i].n);
    }
};

// What is nearest to each of some balled points so far.
struct Nearest {
    float cap;
    std::vector<float> distance;   // with `lane_count` more behind them
    std::vector<int> part, sample; // -1 beyond the cap
    bool loosely = false; // points that may be off the closest sample by the size of a cell are not beyond an edge

    explicit Nearest(int64_t count = 0, float cap = 0);
};

struct SweepTask {
    int configuration, joint; // an actuated joint
    bool base_moves;          // all the rest moves, or else what hangs on the joint
    int with;                 // an actuated joint further out that is swept at each value of the first; -1: none
};

struct ReachTask {
    int configuration, anchor, part; // `part` is to come to T while `anchor` stays
    Rigid T;
};

struct RegrowTask {
    int configuration, start, next; // next: the neighbour of `start` whose side is grown anew; -1: all around `start`
    std::vector<float> weights;     // per part; parts of weight 0 are neither grown to nor taken as explaining
};

// One axis of a grid of scores; the best of a mode's neighbours within `window` on every axis is the mode itself.
struct GridAxis {
    int size, window;
    bool circular;
};

// No score is as low as this.
constexpr float lowest_score = -1e9f;

// The best `modes` of a row of scores, of those above `least`, ...
std::vector<int> best_modes(std::vector<float> row, int modes, GridAxis axis, float least = lowest_score);
// ... and of a grid of them, the second axis running fastest.
std::vector<int> best_modes(std::vector<float> grid, int modes, GridAxis first, GridAxis second,
                            float least = lowest_score);

class Search {
  public:
    Search(const Articulated &model, const ScanField &field, SearchOptions options, std::vector<double> neutral);

    // Let samples of scan points begin with those marked, in the order that they have.
    void look_first(const std::vector<uint8_t> &marked);

    // RANSAC with minimal samples of two oriented points, the first being one of `anchors`, for each of `parts` among
    // its own `points`; the best `keep` distinct poses each. The score counts all scan points by their weight.
    std::vector<Hypothesis> part_hypotheses(const std::vector<int> &parts, const std::vector<std::vector<int>> &points,
                                            int anchors, uint64_t seed, int keep,
                                            const std::vector<float> &point_weights) const;
    // The same from correspondences of one part, in minimal samples of two.
    std::vector<Hypothesis> correspondence_hypotheses(int part, const std::vector<Correspondence> &given, uint64_t seed,
                                                      int keep) const;
    // Refine poses of single parts and score them.
    void refine_parts(std::vector<Hypothesis> &hypotheses, int iterations) const;
    // Indices of hypotheses (in order) that differ from all before by more than `radius`, the first `keep` of a part.
    std::vector<int> distinct(const std::vector<Hypothesis> &hypotheses, int keep, float radius) const;
    // The same of configurations, whose surfaces must differ by more than `apart` on average; the first `keep` of all.
    std::vector<int> distinct(const std::vector<Configuration> &configurations, int keep, float apart) const;
    // The best configurations grown from each placed part, at most `keep`.
    std::vector<Configuration> grow(const std::vector<Hypothesis> &roots, int keep) const;
    // The best `keep` configurations of each task, in task order.
    std::vector<Configuration> regrow(const std::vector<Configuration> &from, const std::vector<RegrowTask> &tasks,
                                      int keep) const;
    // Solve the joints between two parts so that one comes to a given placement, from `starts` random values; the best
    // `keep` of each task that leave less than `tolerance`.
    std::vector<Configuration> reach(const std::vector<Configuration> &from, const std::vector<ReachTask> &tasks,
                                     uint64_t seed, int starts, int keep, float tolerance) const;
    // Sweep one actuated joint of whole configurations, or two together in steps twice as long; the best `keep` modes
    // of each task by the two-way score, but for those whose score falls `behind` what is swept by more.
    std::vector<Configuration> sweep(const std::vector<Configuration> &from, const std::vector<SweepTask> &tasks,
                                     int keep, float behind) const;
    // Two-way scores of whole configurations on a fair sample of at most `points` scan points, one set a distance
    // within which points are covered.
    std::vector<Scores> score(const std::vector<Configuration> &configurations, int points,
                              const std::vector<float> &coverage_distances) const;
    // Gauss-Newton over base and values, robust scale from `sigma_first` to `sigma_last`.
    void refine(std::vector<Configuration> &configurations, int points, int iterations, float sigma_first,
                float sigma_last, float support_weight, const std::vector<float> &part_weights) const;
    // Normal equations of every part at given placements, from the given scan points; `counts` gets those of each part.
    // With `along_rays` points are pulled to what the sensor sees on their rays, not to what is nearest.
    std::vector<Normal> normal_equations(const std::vector<OrientedPoint> &sampled, const std::vector<Rigid> &T,
                                         float sigma, float cap, float support_weight, const float *part_weights,
                                         bool along_rays, std::vector<int> &counts) const;
    // How much of the surface of every part at given placements is in sight, how much of that has a scan point within
    // `distance`, and how much one whose normal agrees with its own. In sight of a sensor is what faces it and is not
    // behind what it saw; without one, all.
    struct Sight {
        std::vector<float> shown, near, confirmed; // (parts,), shares
    };
    Sight in_sight(const std::vector<Rigid> &T, float distance, float cosine) const;
    Assignment assign(const BalledPoints &points, const Rigid *T, const uint8_t *mask, float cap) const;
    // The same of all scan points.
    Assignment owners(const Rigid *T, const uint8_t *mask, float cap) const;
    // Distances of points (at most `cap`) from the nearest of the parts in `mask`, one row of `out` for each of `count`
    // sets of placements. `loosely`: see Nearest.
    void distances(const BalledPoints &points, const std::vector<Rigid> &T, int64_t count, const uint8_t *mask,
                   float cap, bool loosely, float *out) const;
    // Offer the parts in `mask` to points, in the order of their neighbourhood; to those of some `balls` only (null:
    // all).
    void offer(const BalledPoints &points, const Rigid *T, const uint8_t *mask, Nearest &to,
               const uint8_t *balls = nullptr) const;

    const Articulated &model;
    const ScanField &field;
    SearchOptions options;
    std::vector<double> neutral;
    Prior prior; // of a search that knows nothing: empty

  private:
    struct Partial {
        std::vector<Rigid> T;
        std::vector<double> values;
        std::vector<uint8_t> known;
        double score = 0;
    };
    struct Edge {
        int to, joint; // joint: the part whose joint the edge is
    };
    struct Sweep {
        std::vector<double> values;
        std::vector<Rigid> down, up;
        bool circular;
    };
    // The best hypotheses of a part so far; `bar` is the least score of those that count.
    struct Pool {
        static constexpr size_t size = 400;
        std::vector<Hypothesis> best;
        float bar = lowest_score;

        void add(const Hypothesis &candidate);
    };
    struct Growth {
        const float *point_weights;
        const float *part_weights;
        const std::vector<Hypothesis> *placed; // where parts may be; null: not known
    };
    // What a sample of the points tells of a configuration as it is, for all that stands still while a joint moves.
    struct Look {
        Nearest nearest;
        std::vector<int> owner;            // of each scan point
        std::vector<float> support, gains; // gains: of each point of the sample, in the order of their neighbourhood
        float score;
    };
    // The weights of scan points, null where all are 1: that need not be looked up.
    static const float *weights_or_none(const std::vector<float> &weights);
    float part_score(int part, const RigidF &T, int first, int last, float distance, const float *point_weights) const;
    std::vector<Hypothesis> hypotheses_of_part(int part, const std::vector<int> &points, int anchors, uint64_t seed,
                                               int keep, const float *point_weights) const;
    void consider(int part, const Rigid &pose, const float *point_weights, Pool &pool) const;
    std::vector<Hypothesis> best_of(Pool pool, int keep, const float *point_weights) const;
    void refine_part(Hypothesis &hypothesis, int iterations, const float *point_weights) const;
    double close_chain(const ReachTask &task, const Rigid &goal, const std::vector<int> &joints,
                       std::vector<double> &values) const;
    std::vector<Configuration> closed(const ReachTask &task, const Rigid &held, const std::vector<double> &values,
                                      Random random, int starts, int keep, float tolerance) const;
    std::vector<Partial> grow_from(Partial start, int node, int previous, int only, int keep, bool foremost,
                                   const Growth &growth) const;
    std::vector<Partial> cross_edge(std::vector<Partial> states, int node, Edge edge, float leads_to, int most,
                                    const Growth &growth) const;
    std::vector<Edge> silent_path(const Partial &state, int node, Edge edge, const Growth &growth) const;
    std::vector<Partial> cross_silent(const std::vector<Partial> &states, int node, const std::vector<Edge> &path,
                                      const Growth &growth) const;
    bool is_wide(const std::vector<Edge> &path) const;
    std::vector<uint64_t> explaining_parts(const Configuration &c, const BalledPoints &points) const;
    std::vector<Partial> brought(const std::vector<Partial> &states, int node, const std::vector<Edge> &path,
                                 const std::vector<Hypothesis> &placed) const;
    float damped(float score) const;
    double displacement(int part, const Rigid &A, const Rigid &B, bool turning) const;
    std::vector<Partial> unlike(std::vector<Partial> states, int node, int count) const;
    float surface_beyond(int node, int previous, const float *part_weights) const;
    float exclusive_support(int part, const RigidF &T, const std::vector<int> &owner, float distance) const;
    float violation(int part, const RigidF &T, float distance) const;
    float coverage(const PointSample &sample, const Nearest &nearest, const std::vector<RigidF> &T,
                   float distance) const;
    float gain(int point, int part, int sample, float from_part, const std::vector<RigidF> &T, float distance) const;
    void update_support(const std::vector<int> &owner, const std::vector<RigidF> &T, float coverage_distance,
                        const uint8_t *mask, float *support) const;
    const PointSample &sample_of_points(int most) const;
    float gain_at(const BalledPoints &points, int at, const Nearest &nearest, const std::vector<RigidF> &F) const;
    Look look_at(const Configuration &c, const PointSample &sample, const std::vector<uint8_t> &parts) const;
    float total_score(float covered, const float *support) const;
    std::vector<uint8_t> joined_parts() const;
    float overlap(const std::vector<RigidF> &T) const;
    // What speaks against a configuration, whatever the scan.
    float cost(const Configuration &c, const std::vector<RigidF> &T) const;
    void pull_to_model(const PointSample &sampled, float share, const std::vector<Rigid> &T, float sigma, float cap,
                       const SeenSurface *seen, std::vector<Normal> &normal, int *counts, bool loosely) const;
    void pull_to_scan(const std::vector<Rigid> &T, float sigma, float support_weight, const float *part_weights,
                      std::vector<Normal> &normal) const;
    void refine_one(Configuration &c, const PointSample &sampled, int iterations, float sigma_first, float sigma_last,
                    float support_weight, const float *part_weights) const;

    std::vector<std::vector<Edge>> edges;
    std::vector<Sweep> sweeps;
    std::vector<uint8_t> joined; // (parts, parts)
    int support_samples;         // of each part that tell its support
    const float *field_weights;  // as of `weights_or_none`
    float most_trust = 0;        // largest weight of a scan point
    // Scan points in a fixed random order, so that prefixes are fair samples; those of no region come last.
    std::vector<int> shuffled, rank; // rank: the place of each point in it
    // Samples of it by their size, each made when it is first asked for.
    mutable std::map<size_t, PointSample> drawn;
    mutable std::mutex sampling;
};

} // namespace pwr
