#include "lanes.hpp"
#include "search.hpp"

namespace pwr {

// Whether two parts are joined, over parts without a surface too: those may overlap about their joint.
std::vector<uint8_t> Search::joined_parts() const {
    const int n = model.parts;
    std::vector<uint8_t> joined(n * n, 0);
    for (int from = 0; from < n; ++from) {
        std::vector<int> reached{from};
        for (size_t at = 0; at < reached.size(); ++at)
            for (const Edge &e : edges[reached[at]]) {
                if (joined[from * n + e.to]) continue;
                joined[from * n + e.to] = 1;
                if (!model.surface[e.to].exists) reached.push_back(e.to);
            }
    }
    return joined;
}

// Share of the surface of all parts, by their weights, that lies inside parts they are not joined to.
float Search::overlap(const std::vector<RigidF> &T) const {
    constexpr int most_samples = 48;
    constexpr float depth = .01f; // what scans and meshes leave open
    const int n = model.parts;
    float total = 0;
    for (int p = 0; p < n; ++p) {
        const Surface &s = model.surface[p];
        if (!s.exists) continue;
        const Vec centre = apply(T[p], s.centre);
        std::vector<int> others;
        for (int o = 0; o < n; ++o) {
            const Surface &other = model.surface[o];
            if (o == p || joined[p * n + o] || !other.exists) continue;
            if (norm(apply(T[o], other.centre) - centre) < s.radius + other.radius) others.push_back(o);
        }
        const int count = s.count(most_samples);
        float inside = 0;
        for (int i = 0; i < count && !others.empty(); i += lane_count) {
            const VecLanes x = apply(T[p], s.lane_points.at(i));
            IntLanes within{};
            for (int o : others) {
                const Surface &other = model.surface[o];
                const VecLanes local = apply_inverse(T[o], x);
                const IntLanes cells = other.cells_at(local);
                for (int j = 0; j < lane_count; ++j) {
                    const uint16_t sample = cells[j] < 0 ? none : other.grid[cells[j]];
                    if (sample == none) continue;
                    const Vec at{local.x[j], local.y[j], local.z[j]};
                    const OrientedPoint &q = other.dense[sample];
                    float aside;
                    if (other.distance_to(sample, at, aside) > depth && aside <= 0 && dot(at - q.p, q.n) < 0)
                        within[j] = -1;
                }
            }
            within &= first_lanes(count - i);
            inside += sum_of_lanes(within ? load_lanes(&s.lane_weights[i]) : FloatLanes{});
        }
        total += s.weight * inside / s.cumulated[count];
    }
    return total;
}

float Search::cost(const Configuration &c, const std::vector<RigidF> &T) const {
    const float known = prior.cost(c.base, c.values);
    return options.solid ? known + options.overlap_penalty * overlap(T) : known;
}

} // namespace pwr
