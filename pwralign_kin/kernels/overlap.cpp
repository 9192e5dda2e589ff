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
        for (int i = 0; i < count && !others.empty(); ++i) {
            const Vec x = apply(T[p], s.p[i]);
            for (int o : others) {
                const Surface &other = model.surface[o];
                const Vec local = apply_inverse(T[o], x);
                float distance, aside;
                const int sample = other.closest(local, distance, aside);
                if (sample < 0 || aside > 0) continue;
                if (dot(local - other.dense[sample].p, other.dense[sample].n) > -depth) continue;
                inside += s.w[i];
                break;
            }
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
