// Some samples of a part looked up in the scan at once, without branches.
#pragma once
#include "articulated.hpp"
#include "lanes.hpp"

namespace pwr {

// Samples placed in the scan, and the codes of the cells that they are in.
struct PlacedLanes {
    VecLanes place;
    IntLanes code;

    PlacedLanes() = default;
    __attribute__((always_inline)) PlacedLanes(const ScanField &field, const Surface &surface, const RigidF &T,
                                               int first)
        : place(apply(T, surface.lane_points.at(first))), code(field.codes_at(place)) {}
};

struct SampleLanes {
    FloatLanes w;       // weights, 0 beyond the last sample
    VecLanes place;     // placed samples
    IntLanes found;     // whether there is a scan point near to the sample's cell
    FloatLanes free;    // how far the cell is known to be free, in [0, 1]
    VecLanes away;      // sample minus that point, ...
    VecLanes normal;    // ... and the point's normal; both meaningless where none was found
    FloatLanes squared; // squared length of that, infinite where none was found
    FloatLanes cosine;  // cosine between the normals, ...
    FloatLanes facing;  // ... and that, at least 0
    FloatLanes seen; // cosine between the sample's normal and the direction to the sensor, times the sensor's distance
    int nearest[lane_count]; // the scan points, 0 where none was found

    // Look at the samples [first, last) of a surface, at most `lane_count`. What a caller does not use of it costs
    // nothing.
    __attribute__((always_inline)) SampleLanes(const ScanField &field, const Surface &surface, const RigidF &T,
                                               const PlacedLanes &placed, int first, int last)
        : place(placed.place) {
        w = first_lanes(last - first) ? load_lanes(&surface.lane_weights[first]) : FloatLanes{};
        const VecLanes own = rotate(T, surface.lane_normals.at(first));
        const IntLanes code = placed.code;
        found = code >= 0;
        const IntLanes state = code & 3;
        free = state == DepthImage::free     ? all_lanes(1)
               : state == DepthImage::silent ? all_lanes(field.unreturned)
                                             : FloatLanes{};
        store_lanes(found ? code >> 2 : IntLanes{}, nearest);
        seen = dot(field.sensor - place, own);
        if (!any_lane(found)) {
            away = normal = place, squared = all_lanes(1e30f), cosine = facing = FloatLanes{};
            return;
        }
        VecLanes q;
        field.rows.gather(nearest, q, normal);
        away = place - q;
        squared = found ? dot(away, away) : all_lanes(1e30f);
        cosine = dot(own, normal);
        facing = max_lanes(cosine, FloatLanes{});
    }
};

// Call f(samples) for the samples [first, last) of a surface, `lane_count` at a time. The cells of many are read before
// the first is looked at: they are all over the scan, and none waits for the memory of another.
template <typename F> __attribute__((always_inline)) inline void
for_samples(const ScanField &field, const Surface &surface, const RigidF &T, int first, int last, F &&f) {
    constexpr int ahead = 6;
    PlacedLanes placed[ahead];
    for (int from = first; from < last; from += ahead * lane_count) {
        const int to = std::min(last, from + ahead * lane_count);
        for (int i = from, k = 0; i < to; i += lane_count, ++k) placed[k] = PlacedLanes(field, surface, T, i);
        for (int i = from, k = 0; i < to; i += lane_count, ++k) f(SampleLanes(field, surface, T, placed[k], i, last));
    }
}

} // namespace pwr
