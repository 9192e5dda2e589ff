#include "ordering.hpp"
#include "search.hpp"

namespace pwr {

namespace {

// Both parts and all above them but the root, each after its parent.
std::vector<int> parts_to(const Articulated &model, int anchor, int part) {
    std::vector<uint8_t> needed(model.parts, 0);
    for (int p = anchor; p > 0; p = model.parent[p]) needed[p] = 1;
    for (int p = part; p > 0; p = model.parent[p]) needed[p] = 1;
    std::vector<int> parts;
    for (int p = 1; p < model.parts; ++p)
        if (needed[p]) parts.push_back(p);
    return parts;
}

// The actuated joints that move `part` against `anchor`.
std::vector<int> joints_between(const Articulated &model, int anchor, int part) {
    std::vector<uint8_t> above(model.parts, 0);
    for (int p = anchor; p > 0; p = model.parent[p]) above[p] ^= 1;
    for (int p = part; p > 0; p = model.parent[p]) above[p] ^= 1;
    std::vector<int> joints;
    for (int p = 1; p < model.parts; ++p) {
        const int joint = model.actuated[p];
        const bool is_new = std::find(joints.begin(), joints.end(), joint) == joints.end();
        if (above[p] && is_new && model.upper[joint] > model.lower[joint]) joints.push_back(joint);
    }
    return joints;
}

} // namespace

// Damped Gauss-Newton on the chain between two parts. Distances are taken along the part's normals: a part that is
// nearly a body of revolution may turn about its axis. Returns the root mean square distance that is left.
double Search::close_chain(const ReachTask &task, const Rigid &goal, const std::vector<int> &joints,
                           std::vector<double> &values) const {
    const std::vector<int> needed = parts_to(model, task.anchor, task.part);
    constexpr int samples = 24, iterations = 15, look = 6;
    constexpr double hopeless = .25, along = .02;
    const Surface &s = model.surface[task.part];
    const int count = s.count(samples), size = int(joints.size());
    std::vector<Rigid> T(model.parts);
    std::vector<double> twists(6 * model.parts), H(size * size), g(size), columns(6 * size);
    std::vector<uint8_t> slides(size, 0);
    for (int k = 0; k < size; ++k)
        for (const int p : needed) slides[k] |= model.actuated[p] == joints[k] && model.prismatic[p];
    double left = 0;
    for (int iteration = 0; iteration <= iterations; ++iteration) {
        model.forward(Rigid::identity(), values.data(), needed, T.data());
        const Rigid target = T[task.anchor] * goal;
        const RigidF now = to_float(T[task.part]), wanted = to_float(target);
        Normal normal;
        double squares = 0, weights = 0;
        const Vec centre = apply(wanted, s.centre);
        for (int i = 0; i < count; ++i) {
            const Vec x = apply(now, s.p[i]), d = apply(wanted, s.p[i]) - x, n = rotate(wanted, s.n[i]);
            const float gap = dot(d, n);
            normal.add_plane(x - centre, n, gap, s.w[i]);
            normal.add_point(x - centre, d, float(along) * s.w[i]);
            squares += s.w[i] * gap * gap, weights += s.w[i];
        }
        left = std::sqrt(squares / weights);
        if (iteration == iterations || (iteration == look && left > hopeless)) break;
        normal.mirror();
        const double c[3] = {centre.x, centre.y, centre.z};
        for (const int p : needed) model.joint_twist(p, T.data(), c, &twists[6 * p]);
        std::fill(columns.begin(), columns.end(), 0.);
        for (int k = 0; k < size; ++k) {
            for (int p = task.part; p > 0; p = model.parent[p])
                if (model.actuated[p] == joints[k])
                    for (int i = 0; i < 6; ++i) columns[6 * k + i] += twists[6 * p + i];
            for (int p = task.anchor; p > 0; p = model.parent[p])
                if (model.actuated[p] == joints[k])
                    for (int i = 0; i < 6; ++i) columns[6 * k + i] -= twists[6 * p + i];
        }
        for (int k = 0; k < size; ++k) {
            double HS[6] = {};
            g[k] = 0;
            for (int i = 0; i < 6; ++i) {
                for (int j = 0; j < 6; ++j) HS[i] += normal.H[6 * i + j] * columns[6 * k + j];
                g[k] += columns[6 * k + i] * normal.g[i];
            }
            for (int l = 0; l < size; ++l) {
                H[k * size + l] = 0;
                for (int i = 0; i < 6; ++i) H[k * size + l] += columns[6 * l + i] * HS[i];
            }
        }
        for (int k = 0; k < size; ++k) H[k * size + k] = 1.05 * H[k * size + k] + 1e-5 * weights;
        if (!solve_spd(H.data(), g.data(), size)) break;
        double largest = 0;
        for (int k = 0; k < size; ++k) {
            // A slide is as linear far away as it is near.
            const double most = slides[k] ? model.upper[joints[k]] - model.lower[joints[k]] : .5;
            largest = std::max(largest, model.step_joint(joints[k], g[k], most, values[joints[k]]));
        }
        if (largest < 1e-3 && iteration < iterations - 1) iteration = iterations - 1;
    }
    return left;
}

// The best `keep` ways to bring `task.part` to its place while its anchor stays where it is `held`, from the `values`
// and from random ones, that leave less than `tolerance`.
std::vector<Configuration> Search::closed(const ReachTask &task, const Rigid &held, const std::vector<double> &values,
                                          Random random, int starts, int keep, float tolerance) const {
    const std::vector<int> joints = joints_between(model, task.anchor, task.part);
    std::vector<Configuration> found, kept;
    if (joints.empty()) return kept;
    const Rigid goal = inverse(held) * task.T;
    std::vector<Rigid> T(model.parts);
    for (int start = 0; start < starts; ++start) {
        std::vector<double> tried = values;
        if (start > 0)
            for (int j : joints) tried[j] = model.lower[j] + (model.upper[j] - model.lower[j]) * random.uniform();
        const double left = close_chain(task, goal, joints, tried);
        if (left > tolerance) continue;
        model.forward(Rigid::identity(), tried.data(), T.data());
        found.push_back({held * inverse(T[task.anchor]), std::move(tried), float(-left)});
    }
    sort_by_score(found);
    constexpr double same = .15;
    for (Configuration &candidate : found) {
        bool is_new = int(kept.size()) < keep;
        for (const Configuration &other : kept) {
            double apart = 0;
            for (int j : joints) apart = std::max(apart, std::abs(candidate.values[j] - other.values[j]));
            is_new = is_new && apart > same;
        }
        if (is_new) kept.push_back(std::move(candidate));
    }
    return kept;
}

std::vector<Configuration> Search::reach(const std::vector<Configuration> &from, const std::vector<ReachTask> &tasks,
                                         uint64_t seed, int starts, int keep, float tolerance) const {
    std::vector<std::vector<Configuration>> found(tasks.size());
    parallel_for(int64_t(tasks.size()), options.threads, [&](int64_t t) {
        const Configuration &c = from[tasks[t].configuration];
        std::vector<Rigid> T(model.parts);
        model.forward(c.base, c.values.data(), T.data());
        const Random random(seed * 0x9E3779B97F4A7C15ull + uint64_t(t) + 1);
        found[t] = closed(tasks[t], T[tasks[t].anchor], c.values, random, starts, keep, tolerance);
    });
    std::vector<Configuration> out;
    for (auto &f : found) out.insert(out.end(), f.begin(), f.end());
    return out;
}

} // namespace pwr
