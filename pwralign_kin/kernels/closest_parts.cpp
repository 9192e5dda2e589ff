#include "closest_parts.hpp"

namespace pwr {

// Three passes that do not wait for memory: the part's box tells most points apart; the others' cells are fetched, then
// the samples that these name.
void offer_part(const Surface &s, int part, const RigidF &T, const SplitPoints &points, float *best, int *owner,
                int *sample, std::vector<CloseSample> &close) {
    if (int64_t(close.size()) < points.size) close.resize(points.size);
    int found = 0, named = 0;
    for (int64_t block = 0; block < points.size; block += lane_count) {
        const VecLanes local = apply_inverse(T, points.at(block));
        const VecLanes out{max_lanes(abs_lanes(local.x - s.middle.x) - s.half.x, FloatLanes{}),
                           max_lanes(abs_lanes(local.y - s.middle.y) - s.half.y, FloatLanes{}),
                           max_lanes(abs_lanes(local.z - s.middle.z) - s.half.z, FloatLanes{})};
        const FloatLanes limit = load_lanes(best + block);
        const IntLanes near = first_lanes(int(points.size - block)) & (dot(out, out) < limit * limit);
        if (!any_lane(near)) continue;
        const IntLanes cells = s.cells_at(local);
        for (int j = 0; j < lane_count; ++j) {
            if (!near[j] || cells[j] < 0) continue;
            __builtin_prefetch(&s.grid[cells[j]]);
            close[found++] = {int(block) + j, cells[j], {local.x[j], local.y[j], local.z[j]}};
        }
    }
    for (int c = 0; c < found; ++c) {
        const uint16_t named_by_cell = s.grid[close[c].at];
        if (named_by_cell == none) continue;
        __builtin_prefetch(&s.dense[named_by_cell]);
        close[named++] = {close[c].point, named_by_cell, close[c].local};
    }
    for (int c = 0; c < named; ++c) {
        float aside;
        const float distance = s.distance_to(close[c].at, close[c].local, aside);
        const int i = close[c].point;
        if (distance < best[i]) best[i] = distance, owner[i] = part, sample[i] = close[c].at;
    }
}

} // namespace pwr
