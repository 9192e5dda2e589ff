#include "prior.hpp"
#include "parallel.hpp"

namespace pwr {

namespace {
double length(const double *v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }
// The rotation vector that turns unit vector a onto b by the shortest way.
void shortest_turn(const double *a, const double *b, double *w) {
    w[0] = a[1] * b[2] - a[2] * b[1], w[1] = a[2] * b[0] - a[0] * b[2], w[2] = a[0] * b[1] - a[1] * b[0];
    const double sine = length(w), cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    for (int i = 0; i < 3; ++i) w[i] *= sine > 1e-9 ? std::atan2(sine, cosine) / sine : 1;
    if (sine <= 1e-9 && cosine < 0) w[std::abs(a[0]) < .7 ? 0 : 1] = M_PI;
}
void up_of(const Rigid &base, const BasePrior::Direction &up, double *out) {
    for (int i = 0; i < 3; ++i)
        out[i] = base.R[3 * i] * up.in_base[0] + base.R[3 * i + 1] * up.in_base[1] + base.R[3 * i + 2] * up.in_base[2];
}
void way_into(const BasePrior::Box &box, const double *t, double *way) {
    for (int i = 0; i < 3; ++i) way[i] = std::clamp(t[i], box.low[i], box.high[i]) - t[i];
}
double squared(double x) { return x * x; }
double share(double weight, double deviation) { return weight / (deviation * deviation); }
} // namespace

double BasePrior::deviation(const Rigid &base) const {
    double worst = 0, w[3];
    if (position) {
        for (int i = 0; i < 3; ++i) w[i] = position->value[i] - base.t[i];
        worst = std::max(worst, length(w) / position->deviation);
    }
    if (turn) {
        turn_between(base.R, turn->R, w);
        worst = std::max(worst, length(w) / turn->deviation);
    }
    if (up) {
        double direction[3];
        up_of(base, *up, direction);
        shortest_turn(direction, up->in_scan, w);
        worst = std::max(worst, length(w) / up->deviation);
    }
    if (region) {
        way_into(*region, base.t, w);
        worst = std::max(worst, length(w) / region->deviation);
    }
    return worst;
}

void BasePrior::add(const Rigid &base, double weight, double *H, double *g) const {
    double w[3];
    if (position) {
        const double s = share(weight, position->deviation);
        for (int i = 0; i < 3; ++i) H[7 * (3 + i)] += s, g[3 + i] += s * (position->value[i] - base.t[i]);
    }
    if (turn) {
        const double s = share(weight, turn->deviation);
        turn_between(base.R, turn->R, w);
        for (int i = 0; i < 3; ++i) H[7 * i] += s, g[i] += s * w[i];
    }
    if (up) {
        const double s = share(weight, up->deviation);
        double direction[3];
        up_of(base, *up, direction);
        shortest_turn(direction, up->in_scan, w);
        // A turn about the direction itself changes nothing.
        for (int i = 0; i < 3; ++i) {
            g[i] += s * w[i];
            for (int j = 0; j < 3; ++j) H[6 * i + j] += s * ((i == j) - direction[i] * direction[j]);
        }
    }
    if (region) {
        const double s = share(weight, region->deviation);
        way_into(*region, base.t, w);
        for (int i = 0; i < 3; ++i)
            if (w[i] != 0) H[7 * (3 + i)] += s, g[3 + i] += s * w[i];
    }
}

BasePrior BasePrior::widened(double distance, double angle) const {
    BasePrior wide = *this;
    if (wide.position) wide.position->deviation += distance;
    if (wide.turn) wide.turn->deviation += angle;
    if (wide.up) wide.up->deviation += angle;
    if (wide.region) wide.region->deviation += distance;
    return wide;
}

Bounds::Bounds(const BasePrior &known, double deviations) : known(known) {
    if (known.position) position = squared(deviations * known.position->deviation);
    if (known.region) region = squared(deviations * known.region->deviation);
    if (known.turn) turn = std::cos(std::min(M_PI, deviations * known.turn->deviation));
    if (known.up) up = std::cos(std::min(M_PI, deviations * known.up->deviation));
}

bool Bounds::hold(const Rigid &base) const {
    double v[3];
    if (known.position) {
        for (int i = 0; i < 3; ++i) v[i] = known.position->value[i] - base.t[i];
        if (dot(v, v) >= position) return false;
    }
    if (known.region) {
        way_into(*known.region, base.t, v);
        if (dot(v, v) >= region) return false;
    }
    if (known.turn) {
        double trace = 0;
        for (int i = 0; i < 9; ++i) trace += base.R[i] * known.turn->R[i];
        if (.5 * (trace - 1) < turn) return false;
    }
    if (known.up) {
        up_of(base, *known.up, v);
        if (dot(v, known.up->in_scan) < up) return false;
    }
    return true;
}

Prior::Prior(const Articulated &model, BasePrior known, std::vector<double> values,
             std::vector<double> inverse_deviations)
    : base(known), values(std::move(values)), inverse_deviations(std::move(inverse_deviations)) {
    constexpr int draws = 1000;
    // By the number of joints between part and base that can move; beyond them a turn rules nothing out.
    constexpr double slack_distance[] = {.05, .1, .15, .2}, slack_turn[] = {.15, .35, .6, 1.}, any_turn = 4;
    constexpr int last = 3;
    if (!base.says_something()) return;
    constexpr double loose_distance = .01, loose_turn = .03;
    loose = base.widened(loose_distance, loose_turn);
    std::vector<int> between(model.parts, 0);
    for (int p = 0; p < model.parts; ++p) {
        if (p > 0)
            between[p] = between[model.parent[p]] + (model.upper[model.actuated[p]] > model.lower[model.actuated[p]]);
        const double distance = slack_distance[std::min(between[p], last)];
        const double turn = between[p] > last ? any_turn : slack_turn[between[p]];
        wide.emplace_back(base.widened(distance / free_deviations, turn / free_deviations), free_deviations);
    }
    // A fixed seed: what can be reached is a property of the model.
    Random random(21);
    std::vector<Rigid> T(model.parts);
    std::vector<double> drawn(model.joints);
    bases_in_part.resize(model.parts);
    for (int d = 0; d < draws; ++d) {
        for (int j = 0; j < model.joints; ++j)
            drawn[j] = model.lower[j] + random.uniform() * (model.upper[j] - model.lower[j]);
        model.forward(Rigid::identity(), drawn.data(), T.data());
        for (int p = 0; p < model.parts; ++p)
            if (d == 0 || between[p] > 0) bases_in_part[p].push_back(inverse(T[p]));
    }
}

float Prior::base_cost(const Rigid &at) const {
    constexpr double cost_of_deviation = .05;
    return base.says_something() ? float(cost_of_deviation * std::max(0., loose.deviation(at) - free_deviations)) : 0.f;
}

float Prior::joint_cost(int joint, double value) const {
    // Belief breaks ties only: at the edge of belief it weighs as much as a few scan points.
    constexpr double cost_of_variance = .001;
    if (inverse_deviations.empty()) return 0;
    const double deviation = (value - values[joint]) * inverse_deviations[joint];
    return float(cost_of_variance * deviation * deviation);
}

float Prior::cost(const Rigid &at, const std::vector<double> &joints) const {
    float sum = base_cost(at);
    for (int j = 0; j < int(inverse_deviations.size()); ++j) sum += joint_cost(j, joints[j]);
    return sum;
}

bool Prior::reachable(int part, const Rigid &T) const {
    if (bases_in_part.empty()) return true;
    for (const Rigid &inside : bases_in_part[part])
        if (wide[part].hold(T * inside)) return true;
    return false;
}

} // namespace pwr
