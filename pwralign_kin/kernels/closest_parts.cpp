#include "closest_parts.hpp"
#include <numeric>

namespace pwr {

static std::vector<int> as_given(int64_t count) {
    std::vector<int> order(count);
    std::iota(order.begin(), order.end(), 0);
    return order;
}

BalledPoints::BalledPoints(const Vec *given, int64_t stride, int64_t count)
    : BalledPoints(given, stride, as_given(count)) {}

BalledPoints::BalledPoints(const Vec *given, int64_t stride, std::vector<int> order_of_points)
    : order(std::move(order_of_points)) {
    const int64_t count = int64_t(order.size()), balls = (count + lane_count - 1) / lane_count;
    points.make_room(count), centres.make_room(balls), radii.assign(balls + lane_count, 0.f);
    points.size = count, centres.size = balls;
    for (int64_t ball = 0; ball < balls; ++ball) {
        const int64_t first = ball * lane_count, last = std::min(count, first + lane_count);
        const float share = 1.f / (last - first);
        Vec own[lane_count], centre{0, 0, 0};
        for (int64_t i = first; i < last; ++i) {
            own[i - first] = given[order[i] * stride];
            points.set(i, own[i - first]);
            centre = centre + share * own[i - first];
        }
        float squared = 0;
        for (int64_t i = first; i < last; ++i) {
            const Vec d = own[i - first] - centre;
            squared = std::max(squared, dot(d, d));
        }
        centres.set(ball, centre);
        radii[ball] = std::sqrt(squared);
    }
}

namespace {

// Squared distances of local positions from the part's box.
__attribute__((always_inline)) inline FloatLanes squared_from_box(const Surface &s, const VecLanes &local) {
    const VecLanes out{max_lanes(abs_lanes(local.x - s.middle.x) - s.half.x, FloatLanes{}),
                       max_lanes(abs_lanes(local.y - s.middle.y) - s.half.y, FloatLanes{}),
                       max_lanes(abs_lanes(local.z - s.middle.z) - s.half.z, FloatLanes{})};
    return dot(out, out);
}

// Three passes that do not wait for memory: the part's box tells most points apart; the others' cells are fetched, then
// the samples that these name.
class Offer {
  public:
    Offer(const Surface &s, const RigidF &T, const SplitPoints &points, float wider, CloseSamples &close)
        : s(s), T(T), points(points), wider(wider), close(close) {
        close.make_room(points.size);
    }

    // Look at the points from `block` on, `lane_count` of them.
    void look(int64_t block, const float *best) {
        const VecLanes local = apply_inverse(T, points.at(block));
        const FloatLanes limit = load_lanes(best + block);
        const IntLanes near = first_lanes(int(points.size - block)) & (squared_from_box(s, local) < limit * limit);
        if (!any_lane(near)) return;
        const IntLanes cells = s.cells_at(local), kept = near & (cells >= 0);
        for_lanes(kept, [&](int j) { __builtin_prefetch(&s.grid[cells[j]]); });
        add(found, Packing(kept), IntLanes{0, 1, 2, 3, 4, 5, 6, 7} + int(block), cells, local);
    }

    void settle(int part, float *best, int *owner, int *sample) {
        int named = 0;
        for (int c = 0; c < found; ++c) {
            const uint16_t named_by_cell = s.grid[close.at[c]];
            if (named_by_cell == none) continue;
            s.dense_rows.prefetch(named_by_cell);
            close.point[named] = close.point[c], close.at[named] = named_by_cell;
            close.local.set(named++, {close.local.x[c], close.local.y[c], close.local.z[c]});
        }
        for (int c = 0; c < named; c += lane_count) {
            const int here = std::min(lane_count, named - c);
            for (int j = here; j < lane_count; ++j) close.at[c + j] = 0;
            const FloatLanes distance = s.distances_to(&close.at[c], close.local.at(c), wider);
            for (int j = 0; j < here; ++j) {
                const int i = close.point[c + j];
                if (distance[j] < best[i]) best[i] = distance[j], owner[i] = part, sample[i] = close.at[c + j];
            }
        }
    }

  private:
    void add(int &count, const Packing &packed, IntLanes point, IntLanes at, const VecLanes &local) {
        close.set(count, packed(point), packed(at), {packed(local.x), packed(local.y), packed(local.z)});
        count += packed.count;
    }

    const Surface &s;
    const RigidF &T;
    const SplitPoints &points;
    float wider;
    CloseSamples &close;
    int found = 0;
};

} // namespace

void offer_part(const Surface &s, int part, const RigidF &T, const SplitPoints &points, float *best, int *owner,
                int *sample, CloseSamples &close) {
    Offer offer(s, T, points, 0, close);
    for (int64_t block = 0; block < points.size; block += lane_count) offer.look(block, best);
    offer.settle(part, best, owner, sample);
}

void offer_part(const Surface &s, int part, const RigidF &T, const BalledPoints &balled, const uint8_t *balls,
                float cap, float wider, float *best, int *owner, int *sample, CloseSamples &close) {
    constexpr float rounding = 1e-4f;
    Offer offer(s, T, balled.points, wider, close);
    for (int64_t first = 0; first < balled.centres.size; first += lane_count) {
        const FloatLanes reach = load_lanes(&balled.radii[first]) + (cap + rounding);
        const VecLanes local = apply_inverse(T, balled.centres.at(first));
        const IntLanes near =
            first_lanes(int(balled.centres.size - first)) & (squared_from_box(s, local) < reach * reach);
        if (!any_lane(near)) continue;
        for (int j = 0; j < lane_count; ++j)
            if (near[j] && (!balls || balls[first + j])) offer.look((first + j) * lane_count, best);
    }
    offer.settle(part, best, owner, sample);
}

} // namespace pwr
