// The part whose surface is nearest to each of many points.
#pragma once
#include "articulated.hpp"

namespace pwr {

// Points that a part may be near to, and what they are near to: memory that is used again.
struct CloseSamples {
    std::vector<int> point, at; // at: cell of the part's grid, then the sample that it names
    SplitPoints local;          // the points in the part's frame

    void make_room(int64_t points) {
        if (int64_t(at.size()) >= points + lane_count) return;
        point.resize(points + lane_count), at.resize(points + lane_count), local.make_room(points + lane_count);
    }
    // Write a few of them from `place` on.
    void set(int place, IntLanes points, IntLanes cells, const VecLanes &positions) {
        store_lanes(points, &point[place]), store_lanes(cells, &at[place]);
        local.set(place, positions);
    }
};

// Points with a ball around every `lane_count` of them, which tells at once that a part is far from all of these.
struct BalledPoints {
    std::vector<int> order; // of each point, among those given
    SplitPoints points, centres;
    std::vector<float> radii; // with `lane_count` more behind them that are read

    // `order` should bring neighbours next to each other, or the balls are wide.
    BalledPoints(const Vec *given, int64_t stride, std::vector<int> order);
    // The same in the order given.
    BalledPoints(const Vec *given, int64_t stride, int64_t count);
};

// Offer a placed part to points: `best` holds the distances to beat, with `lane_count` more behind them that are read;
// where the part is nearer, `best`, `owner` and `sample` tell. `close` is memory that is used again.
void offer_part(const Surface &surface, int part, const RigidF &T, const SplitPoints &points, float *best, int *owner,
                int *sample, CloseSamples &close);
// The same where no distance to beat is larger than `cap`, of the points in some `balls` only (null: in all). The discs
// that the surface is taken as are larger by `wider`.
void offer_part(const Surface &surface, int part, const RigidF &T, const BalledPoints &points, const uint8_t *balls,
                float cap, float wider, float *best, int *owner, int *sample, CloseSamples &close);

} // namespace pwr
