#include "ordering.hpp"
#include "search.hpp"
#include <limits>
#include <numeric>
#include <queue>

namespace pwr {

Search::Search(const Articulated &model, const ScanField &field, SearchOptions options, std::vector<double> neutral)
    : model(model), field(field), options(options), neutral(std::move(neutral)) {
    edges.resize(model.parts);
    sweeps.resize(model.parts);
    for (int i = 1; i < model.parts; ++i) {
        edges[i].push_back({model.parent[i], i});
        edges[model.parent[i]].push_back({i, i});
        const int joint = model.actuated[i];
        const double low = model.lower[joint], span = model.upper[joint] - low;
        Sweep &sweep = sweeps[i];
        sweep.circular = model.wraps[joint];
        int steps = 1;
        if (span > 1e-9) {
            constexpr double slide_step = .015;
            constexpr int slide_steps = 25;
            steps = model.prismatic[i] ? std::min(slide_steps, int(span / slide_step) + 2)
                                       : int(std::ceil(span / options.angle_step));
            steps = std::max(3, steps);
        }
        for (int v = 0; v < steps; ++v) {
            const double share = steps == 1 ? 0. : double(v) / (sweep.circular ? steps : steps - 1);
            sweep.values.push_back(low + span * share);
            sweep.down.push_back(model.joint_placement(i, sweep.values.back()));
            sweep.up.push_back(inverse(sweep.down.back()));
        }
    }
    joined = joined_parts();
    // Whole models are scored by some thousand samples, however many their parts.
    constexpr int samples_of_part = 100, samples_of_model = 3200, fewest = 24;
    int with_surface = 1;
    for (const Surface &s : model.surface) with_surface += s.exists;
    support_samples = std::clamp(samples_of_model / with_surface, fewest, samples_of_part);
    field_weights = weights_or_none(field.weight);
    for (const float weight : field.weight) most_trust = std::max(most_trust, weight);
    // A fixed seed: the order is a property of the scan, not of the search.
    Random random(20);
    shuffled.resize(field.points.size());
    std::iota(shuffled.begin(), shuffled.end(), 0);
    for (size_t i = shuffled.size(); i > 1; --i) std::swap(shuffled[i - 1], shuffled[random.below(uint32_t(i))]);
    std::stable_partition(shuffled.begin(), shuffled.end(), [&](int k) { return field.region[k] >= 0; });
    rank.resize(shuffled.size());
    for (size_t i = 0; i < shuffled.size(); ++i) rank[shuffled[i]] = int(i);
}

void Search::look_first(const std::vector<uint8_t> &marked) {
    std::stable_partition(shuffled.begin(), shuffled.end(), [&](int k) { return marked[k]; });
    for (size_t i = 0; i < shuffled.size(); ++i) rank[shuffled[i]] = int(i);
    drawn.clear();
}

// Weight of the surface of a part and all that is reached from it, but for one neighbour's side.
float Search::surface_beyond(int node, int previous, const float *part_weights) const {
    float sum = model.surface[node].exists ? part_weights[node] : 0.f;
    for (const Edge &e : edges[node])
        if (e.to != previous) sum += surface_beyond(e.to, node, part_weights);
    return sum;
}

std::vector<int> best_modes(std::vector<float> row, int modes, GridAxis axis, float least) {
    return best_modes(std::move(row), modes, {1, 0, false}, axis, least);
}

std::vector<int> best_modes(std::vector<float> grid, int modes, GridAxis first, GridAxis second, float least) {
    constexpr float taken = lowest_score;
    auto at = [](int i, GridAxis axis) {
        if (axis.circular) return (i % axis.size + axis.size) % axis.size;
        return i < 0 || i >= axis.size ? -1 : i;
    };
    std::vector<int> chosen;
    while (int(chosen.size()) < modes) {
        const int best = int(std::max_element(grid.begin(), grid.end()) - grid.begin());
        if (grid[best] <= std::max(taken, least)) break;
        chosen.push_back(best);
        for (int a = -first.window; a <= first.window; ++a)
            for (int b = -second.window; b <= second.window; ++b) {
                const int i = at(best / second.size + a, first), j = at(best % second.size + b, second);
                if (i >= 0 && j >= 0) grid[i * second.size + j] = taken;
            }
    }
    return chosen;
}

// Without occlusion knowledge an unsupported part is absent, whatever its pose: poses barely differ.
float Search::damped(float score) const { return field.has_origin || score >= 0 ? score : .02f * score; }

namespace {

// The least of the best `most` scores, below which nothing counts any more.
class Bar {
  public:
    explicit Bar(int most) : most(most) {}
    void add(double score) {
        best.push(score);
        if (int(best.size()) > most) best.pop();
    }
    double height() const { return int(best.size()) < most ? -std::numeric_limits<double>::infinity() : best.top(); }

  private:
    int most;
    std::priority_queue<double, std::vector<double>, std::greater<double>> best;
};

} // namespace

// Sweep the joint of `edge` in every state (given best first); the best `most` of all states and modes survive. What
// cannot be among them whatever the samples not looked at say is left out.
std::vector<Search::Partial> Search::cross_edge(std::vector<Partial> states, int node, Edge edge, float leads_to,
                                                int most, const Growth &growth) const {
    struct Candidate {
        int state;
        double value, score;
        Rigid T;
    };
    constexpr int first_samples = 16, silent_modes = 24;
    const Sweep &sweep = sweeps[edge.joint];
    const bool down = edge.to == edge.joint;
    const int joint = model.actuated[edge.joint];
    const Surface &s = model.surface[edge.to];
    const float weight = growth.part_weights[edge.to];
    // Wide beams are for what holds a good deal of the surface: little can be won at fingers.
    constexpr float little = .03f;
    constexpr int narrow_beam = 8, narrow_modes = 5;
    const bool leads_somewhere = leads_to > 0, is_narrow = leads_to < little;
    const int beam = std::min({most, options.beam, is_narrow ? narrow_beam : options.beam});
    const int most_modes = is_narrow ? std::min(options.modes, narrow_modes) : options.modes;
    const bool scored = s.exists && weight > 0;
    const int first = s.count(first_samples), last = s.count(options.sweep_samples);
    // Sums are rounded: what is hoped for is a little more than what can be.
    constexpr double rounding = 1e-5;
    auto hoped = [&](float share) { return scored ? weight * std::max(0.f, damped(share)) + rounding : rounding; };
    Bar bar(beam);
    std::vector<Candidate> candidates;
    auto add = [&](Candidate candidate) {
        bar.add(candidate.score);
        candidates.push_back(candidate);
    };
    std::vector<float> row, early;
    std::vector<int> order;
    for (int i = 0; i < int(states.size()); ++i) {
        const Partial &state = states[i];
        double missing = bar.height() - state.score;
        if (hoped(most_trust) < missing) continue;
        if (state.known[joint]) {
            const Rigid motion = model.joint_placement(edge.joint, state.values[joint]);
            const Rigid T = state.T[node] * (down ? motion : inverse(motion));
            float value = 0;
            if (scored)
                value = weight * damped(part_score(edge.to, to_float(T), 0, last, options.support_distance,
                                                   growth.point_weights) /
                                        s.cumulated[last]);
            add({i, state.values[joint], state.score + value - (edge.to == 0 ? prior.base_cost(T) : 0.f), T});
            continue;
        }
        if (!leads_somewhere) {
            // Nothing to see on that side: keep the prior value.
            const double value = std::clamp(state.values[joint], model.lower[joint], model.upper[joint]);
            const Rigid motion = model.joint_placement(edge.joint, value);
            add({i, value, state.score, state.T[node] * (down ? motion : inverse(motion))});
            continue;
        }
        const int steps = int(sweep.values.size());
        std::vector<Rigid> T(steps);
        row.assign(steps, 0.f);
        for (int v = 0; v < steps; ++v) T[v] = state.T[node] * (down ? sweep.down[v] : sweep.up[v]);
        auto price = [&](int v) {
            return prior.joint_cost(joint, sweep.values[v]) + (edge.to == 0 ? prior.base_cost(T[v]) : 0.f);
        };
        if (scored) {
            early.resize(steps);
            for (int v = 0; v < steps; ++v)
                early[v] =
                    part_score(edge.to, to_float(T[v]), 0, first, options.support_distance, growth.point_weights);
            // Only the promising half of the values sees all samples.
            order.resize(steps);
            std::iota(order.begin(), order.end(), 0);
            const int full = std::max(std::min(steps, 2 * most_modes), steps / 2);
            std::nth_element(order.begin(), order.begin() + (full - 1), order.end(),
                             [&](int a, int b) { return early[a] != early[b] ? early[a] > early[b] : a < b; });
            auto worth = [&](float share) { return weight * damped(share); };
            for (int v = 0; v < steps; ++v) row[v] = worth(early[v] / std::max(1e-9f, s.cumulated[first]) - 1.f);
            const float rest = most_trust * (s.cumulated[last] - s.cumulated[first]);
            for (int at = 0; at < full; ++at) {
                const int v = order[at];
                if (hoped((early[v] + rest) / s.cumulated[last]) < missing) {
                    row[v] = lowest_score;
                    continue;
                }
                row[v] = worth((early[v] + part_score(edge.to, to_float(T[v]), first, last, options.support_distance,
                                                      growth.point_weights)) /
                               s.cumulated[last]);
                // Where one survives, it is the best of a state: what is worse need not be known.
                if (beam == 1) missing = std::max(missing, double(row[v] - price(v)));
            }
        }
        for (int v = 0; v < steps; ++v) row[v] -= price(v);
        int modes, window;
        if (scored)
            modes = std::min(most_modes, steps), window = std::max(std::min(1, steps - 1), std::min(2, steps / 8));
        else
            modes = std::min(silent_modes, steps),
            window = std::max(0, int(std::ceil(steps / double(silent_modes) / 2 - .01)));
        for (int v : best_modes(row, std::min(modes, beam), {steps, window, sweep.circular}, float(missing - rounding)))
            add({i, sweep.values[v], state.score + row[v], T[v]});
    }
    sort_by_score(candidates, beam);
    std::vector<int> uses(states.size(), 0);
    for (const Candidate &c : candidates) ++uses[c.state];
    std::vector<Partial> next;
    next.reserve(candidates.size());
    for (const Candidate &c : candidates) {
        if (--uses[c.state] == 0) next.push_back(std::move(states[c.state]));
        else next.push_back(states[c.state]);
        next.back().T[edge.to] = c.T;
        next.back().values[joint] = c.value;
        next.back().known[joint] = 1;
        next.back().score = c.score;
    }
    return next;
}

// The edges from `edge` over parts without surface to the first part with some; `edge` alone where that is the next.
std::vector<Search::Edge> Search::silent_path(const Partial &state, int node, Edge edge, const Growth &growth) const {
    std::vector<Edge> path{edge};
    std::vector<uint8_t> known = state.known;
    while (true) {
        const Edge last = path.back();
        uint8_t &told = known[model.actuated[last.joint]];
        if (told) return {edge};
        told = 1;
        if (model.surface[last.to].exists && growth.part_weights[last.to] > 0) return path;
        int onward = 0;
        for (const Edge &e : edges[last.to])
            if (e.to != node && ++onward == 1) path.push_back(e);
        if (onward != 1) return {edge};
        node = last.to;
    }
}

// Turn all joints of a silent path together, in coarse steps, and keep the states at the last but one of its parts from
// which that with surface can come to lie best. The parts between show nothing: one by one, all values were alike.
std::vector<Search::Partial> Search::cross_silent(const std::vector<Partial> &states, int node,
                                                  const std::vector<Edge> &path, const Growth &growth) const {
    struct Way {
        int state, number; // number: of the coarse values of the silent joints, the last running fastest
        Rigid T;           // of the part reached
        double cost, score;
    };
    constexpr int samples = 16, least_stride = 3, short_path = 3;
    const int end = path.back().to;
    const int silent = int(path.size()) - 1;
    // Long paths are rare: they lead past parts that the scan lacks.
    const size_t most_ways = int(path.size()) > short_path ? 6000 : 600;
    const size_t most = std::max<size_t>(most_ways, most_ways / 10 * states.size());
    std::vector<std::vector<int>> chosen;
    size_t ways_of_state = most + 1;
    for (int stride = least_stride; ways_of_state * states.size() > most; ++stride) {
        chosen.assign(path.size(), {});
        ways_of_state = 1;
        for (size_t k = 0; k < path.size(); ++k) {
            const int steps = int(sweeps[path[k].joint].values.size());
            for (int v = (steps - 1) % stride / 2; v < steps; v += stride) chosen[k].push_back(v);
            ways_of_state *= chosen[k].size();
        }
    }
    auto motion = [&](const Edge &e, int v) -> const Rigid & {
        return e.to == e.joint ? sweeps[e.joint].down[v] : sweeps[e.joint].up[v];
    };
    std::vector<Way> ways;
    for (int i = 0; i < int(states.size()); ++i) ways.push_back({i, 0, states[i].T[node], 0, 0});
    for (int k = 0; k < silent; ++k) {
        std::vector<Way> further;
        further.reserve(ways.size() * chosen[k].size());
        for (const Way &way : ways)
            for (int c = 0; c < int(chosen[k].size()); ++c) {
                const int v = chosen[k][c];
                Way next{way.state, way.number * int(chosen[k].size()) + c, way.T * motion(path[k], v), way.cost, 0};
                next.cost += prior.joint_cost(model.actuated[path[k].joint], sweeps[path[k].joint].values[v]);
                if (path[k].to == 0) next.cost += prior.base_cost(next.T);
                further.push_back(next);
            }
        ways = std::move(further);
    }
    const Surface &s = model.surface[end];
    const int count = s.count(samples);
    for (Way &way : ways) {
        float best = -1e9f;
        Rigid best_T = way.T;
        for (int v : chosen.back()) {
            const Rigid T = way.T * motion(path.back(), v);
            const float score = part_score(end, to_float(T), 0, count, options.support_distance, growth.point_weights);
            if (score > best) best = score, best_T = T;
        }
        way.T = best_T;
        way.score = states[way.state].score + growth.part_weights[end] * damped(best / s.cumulated[count]) - way.cost;
    }
    sort_by_score(ways);
    constexpr double apart = .05;
    std::vector<Way> kept;
    for (const Way &way : ways) {
        if (int(kept.size()) == options.beam) break;
        const bool is_new = std::none_of(kept.begin(), kept.end(), [&](const Way &other) {
            return way.state == other.state && displacement(end, way.T, other.T, true) < apart;
        });
        if (is_new) kept.push_back(way);
    }
    std::vector<Partial> entered;
    for (const Way &way : kept) {
        Partial state = states[way.state];
        int number = way.number;
        std::vector<int> at(silent);
        for (int k = silent - 1; k >= 0; --k) {
            at[k] = chosen[k][number % chosen[k].size()];
            number /= int(chosen[k].size());
        }
        int from = node;
        for (int k = 0; k < silent; ++k) {
            const int joint = model.actuated[path[k].joint];
            state.T[path[k].to] = state.T[from] * motion(path[k], at[k]);
            state.values[joint] = sweeps[path[k].joint].values[at[k]];
            state.known[joint] = 1;
            from = path[k].to;
        }
        state.score -= way.cost;
        entered.push_back(std::move(state));
    }
    return entered;
}

// Whether a joint of the path slides so far that refinement does not bridge the steps of its sweep.
bool Search::is_wide(const std::vector<Edge> &path) const {
    constexpr double bridged = .1;
    return std::any_of(path.begin(), path.end(), [&](const Edge &e) {
        const std::vector<double> &values = sweeps[e.joint].values;
        return model.prismatic[e.joint] && values.size() > 1 && values[1] - values[0] > bridged;
    });
}

// States in which the part at the end of the path is where one of its hypotheses places it, all joints of the path
// solved together. States in which one of these joints is known have nothing to solve.
std::vector<Search::Partial> Search::brought(const std::vector<Partial> &states, int node,
                                             const std::vector<Edge> &path,
                                             const std::vector<Hypothesis> &placed) const {
    constexpr int starts = 6, kept = 2;
    constexpr float tolerance = .03f;
    std::vector<Partial> reached;
    for (const Partial &state : states) {
        const bool is_open =
            std::none_of(path.begin(), path.end(), [&](const Edge &e) { return state.known[model.actuated[e.joint]]; });
        for (size_t h = 0; is_open && h < placed.size(); ++h) {
            if (placed[h].part != path.back().to) continue;
            const ReachTask task{0, node, placed[h].part, placed[h].T};
            for (const Configuration &c :
                 closed(task, state.T[node], state.values, Random(h + 1), starts, kept, tolerance)) {
                Partial next = state;
                int from = node;
                for (const Edge &e : path) {
                    const int joint = model.actuated[e.joint];
                    const Rigid motion = model.joint_placement(e.joint, c.values[joint]);
                    next.T[e.to] = next.T[from] * (e.to == e.joint ? motion : inverse(motion));
                    next.values[joint] = c.values[joint];
                    next.known[joint] = 1;
                    next.score -= prior.joint_cost(joint, c.values[joint]);
                    if (e.to == 0) next.score -= prior.base_cost(next.T[0]);
                    from = e.to;
                }
                reached.push_back(std::move(next));
            }
        }
    }
    return reached;
}

// Mean displacement of some samples of a part between two placements; that of its frame where it has none, and where
// `turning` whichever is more: a turn about its own axis hardly moves a round part.
double Search::displacement(int part, const Rigid &A, const Rigid &B, bool turning) const {
    constexpr float arm = .1f;
    const Surface &s = model.surface[part];
    const int probes = s.count(8);
    const RigidF a = to_float(A), b = to_float(B);
    const double of_frame = norm(apply(a, {arm, arm, arm}) - apply(b, {arm, arm, arm}));
    if (!s.exists) return of_frame;
    double sum = 0;
    for (int i = 0; i < probes; ++i) sum += norm(apply(a, s.p[i]) - apply(b, s.p[i]));
    return turning ? std::max(sum / probes, of_frame) : sum / probes;
}

// The best `count` states (given best first) that place `node` differently, filled up with the best of the others.
std::vector<Search::Partial> Search::unlike(std::vector<Partial> states, int node, int count) const {
    if (int(states.size()) <= count) return states;
    constexpr double apart = .04;
    std::vector<Partial> kept, others;
    for (Partial &state : states) {
        bool is_new = int(kept.size()) < count;
        for (const Partial &other : kept)
            is_new = is_new && displacement(node, state.T[node], other.T[node], false) > apart;
        (is_new ? kept : others).push_back(std::move(state));
    }
    for (size_t i = 0; int(kept.size()) < count; ++i) kept.push_back(std::move(others[i]));
    return kept;
}

// Beam search away from `previous`. Along a chain the beam is carried on; at a branching every branch grows on its own
// from each of the few best states, so that the branches do not multiply. What grows from any but the foremost of these
// has one state at each further branching, or the time would double with every branching on the way outwards.
std::vector<Search::Partial> Search::grow_from(Partial start, int node, int previous, int only, int keep, bool foremost,
                                               const Growth &growth) const {
    std::vector<Partial> states{std::move(start)};
    while (true) {
        std::vector<Edge> onward;
        for (const Edge &e : edges[node])
            if (e.to != previous && (only < 0 || e.to == only)) onward.push_back(e);
        if (onward.empty()) break;
        if (onward.size() > 1) {
            states = unlike(std::move(states), node, foremost ? options.branch_beam : 1);
            for (size_t i = 0; i < states.size(); ++i)
                for (const Edge &e : onward)
                    states[i] =
                        grow_from(std::move(states[i]), node, previous, e.to, 1, foremost && i == 0, growth).front();
            sort_by_score(states);
            break;
        }
        const std::vector<Edge> path = silent_path(states.front(), node, onward.front(), growth);
        previous = node;
        std::vector<Partial> bridged;
        if (growth.placed && is_wide(path)) bridged = brought(states, node, path, *growth.placed);
        if (path.size() > 1) {
            states = cross_silent(states, node, path, growth);
            previous = path[path.size() - 2].to;
        }
        std::move(bridged.begin(), bridged.end(), std::back_inserter(states));
        node = path.back().to;
        const int most = edges[node].size() > 1 ? options.beam : keep;
        states = cross_edge(std::move(states), previous, path.back(),
                            surface_beyond(node, previous, growth.part_weights), most, growth);
        only = -1;
    }
    if (int(states.size()) > keep) states.resize(keep);
    return states;
}

std::vector<int> Search::distinct(const std::vector<Configuration> &configurations, int keep, float apart) const {
    constexpr int probes = 12; // of each part
    std::vector<int> kept;
    std::vector<std::vector<Vec>> seen;
    std::vector<Rigid> T(model.parts);
    for (size_t c = 0; c < configurations.size() && int(kept.size()) < keep; ++c) {
        model.forward(configurations[c].base, configurations[c].values.data(), T.data());
        std::vector<Vec> placed;
        for (int p = 0; p < model.parts; ++p) {
            const Surface &s = model.surface[p];
            const RigidF F = to_float(T[p]);
            for (int i = 0; s.exists && i < s.count(probes); ++i) placed.push_back(apply(F, s.p[i]));
        }
        const double enough = double(apart) * placed.size();
        const bool is_new = std::all_of(seen.begin(), seen.end(), [&](const std::vector<Vec> &other) {
            double sum = 0;
            for (size_t i = 0; i < placed.size() && sum <= enough; ++i) sum += norm(placed[i] - other[i]);
            return sum > enough;
        });
        if (!is_new) continue;
        kept.push_back(int(c));
        seen.push_back(std::move(placed));
    }
    return kept;
}

static std::vector<Configuration> flattened(const std::vector<std::vector<Configuration>> &several) {
    std::vector<Configuration> all;
    for (const auto &own : several) all.insert(all.end(), own.begin(), own.end());
    return all;
}

std::vector<Configuration> Search::grow(const std::vector<Hypothesis> &roots, int keep) const {
    std::vector<std::vector<Configuration>> grown(roots.size());
    std::vector<float> weights;
    for (const Surface &s : model.surface) weights.push_back(s.weight);
    parallel_for(int64_t(roots.size()), options.threads, [&](int64_t i) {
        Partial start{std::vector<Rigid>(model.parts, Rigid::identity()), neutral,
                      std::vector<uint8_t>(model.joints, 0), 0};
        start.T[roots[i].part] = roots[i].T;
        start.score = weights[roots[i].part] * roots[i].score;
        const Growth growth{field_weights, weights.data(), &roots};
        for (const Partial &state : grow_from(start, roots[i].part, -1, -1, keep, true, growth))
            grown[i].push_back({state.T[0], state.values, float(state.score)});
    });
    return flattened(grown);
}

// Bit by bit the parts of a configuration that explain each scan point, in words of 64 parts: points run fastest.
std::vector<uint64_t> Search::explaining_parts(const Configuration &c, const BalledPoints &points) const {
    constexpr float explaining_distance = .025f;
    const int64_t count = int64_t(points.order.size());
    std::vector<uint64_t> explaining((model.parts + 63) / 64 * count, 0);
    std::vector<Rigid> T(model.parts);
    model.forward(c.base, c.values.data(), T.data());
    for (int p = 0; p < model.parts; ++p) {
        if (!model.surface[p].exists) continue;
        std::vector<uint8_t> alone(model.parts, 0);
        alone[p] = 1;
        Nearest near(count, explaining_distance);
        offer(points, T.data(), alone.data(), near);
        for (int64_t at = 0; at < count; ++at)
            explaining[p / 64 * count + points.order[at]] |= uint64_t(near.part[at] == p) << p % 64;
    }
    return explaining;
}

std::vector<Configuration> Search::regrow(const std::vector<Configuration> &from, const std::vector<RegrowTask> &tasks,
                                          int keep) const {
    const BalledPoints points(&field.points[0].p, 2, field.curve);
    const int64_t count = int64_t(field.points.size());
    // Looked up once for all tasks: of what explains a point only what stands still in a task counts there.
    std::vector<uint8_t> cut(from.size(), 0);
    for (const RegrowTask &task : tasks) cut[task.configuration] |= task.next >= 0;
    std::vector<std::vector<uint64_t>> explaining(from.size());
    parallel_for(int64_t(from.size()), options.threads, [&](int64_t c) {
        if (cut[c]) explaining[c] = explaining_parts(from[c], points);
    });
    std::vector<std::vector<Configuration>> grown(tasks.size());
    parallel_for(int64_t(tasks.size()), options.threads, [&](int64_t i) {
        const RegrowTask &task = tasks[i];
        const Configuration &c = from[task.configuration];
        Partial start{std::vector<Rigid>(model.parts), c.values, std::vector<uint8_t>(model.joints, 0), 0};
        model.forward(c.base, c.values.data(), start.T.data());
        std::vector<float> point_weights;
        if (task.next >= 0) {
            std::vector<uint64_t> fixed((model.parts + 63) / 64, 0), explained(count, 0);
            const bool downward = task.next > task.start && model.parent[task.next] == task.start;
            const int cut = downward ? task.next : task.start;
            for (int p = 0; p < model.parts; ++p) {
                const bool moves = model.below(p, cut) == downward;
                if (moves) continue;
                if (p > 0 && p != cut) start.known[model.actuated[p]] = 1;
                if (task.weights[p] > 0) fixed[p / 64] |= uint64_t(1) << p % 64;
            }
            for (size_t word = 0; word < fixed.size(); ++word)
                for (int64_t k = 0; k < count; ++k)
                    explained[k] |= fixed[word] & explaining[task.configuration][word * count + k];
            point_weights.resize(count);
            for (int64_t k = 0; k < count; ++k)
                point_weights[k] = field.weight[k] * (explained[k] ? options.explained_weight : 1.f);
        }
        const Growth growth{point_weights.empty() ? field_weights : point_weights.data(), task.weights.data(), nullptr};
        for (const Partial &state : grow_from(start, task.start, -1, task.next, keep, true, growth))
            grown[i].push_back({state.T[0], state.values, float(state.score)});
    });
    return flattened(grown);
}

} // namespace pwr
