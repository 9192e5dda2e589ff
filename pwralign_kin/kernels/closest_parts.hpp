// The part whose surface is nearest to each of many points.
#pragma once
#include "articulated.hpp"

namespace pwr {

struct CloseSample {
    int point, at; // cell of the part's grid, then the sample that it names
    Vec local;
};

// Offer a placed part to points: `best` holds the distances to beat, with `lane_count` more behind them that are read;
// where the part is nearer, `best`, `owner` and `sample` tell. `close` is memory that is used again.
void offer_part(const Surface &surface, int part, const RigidF &T, const SplitPoints &points, float *best, int *owner,
                int *sample, std::vector<CloseSample> &close);

} // namespace pwr
