// Bindings of the search: the field of a scan, and configurations held against it.
#include "arrays.hpp"
#include "bindings.hpp"
#include "configurations.hpp"
#include <limits>

namespace pwr {

namespace {

void require_surface(const Articulated &model, int part) {
    require(part >= 0 && part < model.parts && model.surface[part].exists, "a hypothesis needs a part with a surface");
}
std::vector<Hypothesis> read_hypotheses(const Articulated &model, const Ints &parts, const Placements &placements) {
    require(parts.shape(0) == placements.shape(0), "parts (m,) and placements (m, 4, 4) differ in length");
    std::vector<Hypothesis> out(parts.shape(0));
    for (size_t i = 0; i < out.size(); ++i) {
        const int part = parts.data()[i];
        require_surface(model, part);
        out[i] = {part, read_placement(placements.data() + 16 * i), 0};
    }
    return out;
}
nb::tuple write_hypotheses(const std::vector<Hypothesis> &hypotheses) {
    std::vector<int> parts;
    std::vector<double> placements(16 * hypotheses.size());
    std::vector<float> scores;
    for (size_t i = 0; i < hypotheses.size(); ++i) {
        parts.push_back(hypotheses[i].part);
        write_placement(hypotheses[i].T, &placements[16 * i]);
        scores.push_back(hypotheses[i].score);
    }
    return nb::make_tuple(to_numpy(std::move(parts)), to_numpy(std::move(placements), {hypotheses.size(), 4, 4}),
                          to_numpy(std::move(scores)));
}
// Where the parts of a configuration are, and which of them may own points: those in the mask that have a surface.
struct PlacedParts {
    std::vector<Rigid> T;
    std::vector<uint8_t> used;
    PlacedParts(const Articulated &model, const Placements &placements, const Bytes &mask)
        : T(part_placements(model, placements)) {
        require(int(mask.shape(0)) == model.parts, "one entry of the mask per part is needed");
        for (int p = 0; p < model.parts; ++p) used.push_back(mask.data()[p] && model.surface[p].exists);
    }
};
nb::tuple write_assignment(Assignment a) {
    return nb::make_tuple(to_numpy(std::move(a.distance)), to_numpy(std::move(a.part)), to_numpy(std::move(a.sample)));
}

} // namespace

void bind_field(nb::module_ &m) {
    nb::class_<ScanField> type(m, "ScanField");
    type.def("__init__",
             [](ScanField *self, Points points, Points normals, Floats weights, Floats areas, Ints regions, float cell,
                float truncation, std::vector<float> sensor_origin, Points depth_points, Points borders, float pixel,
                float tolerance, float shadow, float unreturned, int threads) {
        const size_t count = points.shape(0);
        require(count > 0 && normals.shape(0) == count && weights.shape(0) == count && areas.shape(0) == count &&
                    regions.shape(0) == count,
                "the arrays of the points differ in length");
        require_cells(points, cell);
        require(sensor_origin.empty() || sensor_origin.size() == 3, "a sensor origin has three coordinates");
        const Vec sensor =
            sensor_origin.empty() ? Vec{0, 0, 0} : Vec{sensor_origin[0], sensor_origin[1], sensor_origin[2]};
        nb::gil_scoped_release release;
        new (self) ScanField(copied(points), copied(normals), {weights.data(), weights.data() + count},
                             {areas.data(), areas.data() + count}, {regions.data(), regions.data() + count}, cell,
                             truncation, sensor_origin.empty() ? nullptr : &sensor, copied(depth_points),
                             copied(borders), pixel, tolerance, shadow, unreturned, threads);
    },
             "points"_a, "normals"_a, "weights"_a, "areas"_a, "regions"_a, "cell"_a, "truncation"_a, "sensor_origin"_a,
             "depth_points"_a, "borders"_a, "pixel"_a, "tolerance"_a, "shadow"_a, "unreturned"_a, "threads"_a);
    type.def("with_unreturned", [](const ScanField &self, float unreturned) {
        ScanField other = self;
        other.unreturned = unreturned;
        return other;
    }, "unreturned"_a);
    type.def("nearest", [](const ScanField &self, Points points, float reach) {
        std::vector<int> nearest(points.shape(0));
        for (size_t i = 0; i < nearest.size(); ++i) {
            const Vec p = vectors(points)[i];
            const int found = self.nearest(p);
            nearest[i] = found >= 0 && norm(self.points[found].p - p) < reach ? found : -1;
        }
        return to_numpy(std::move(nearest));
    }, "points"_a, "reach"_a = std::numeric_limits<float>::infinity());
}

void bind_search(nb::module_ &m) {
    nb::class_<SearchOptions>(m, "SearchOptions")
        .def(nb::init<>())
        .def_rw("support_distance", &SearchOptions::support_distance)
        .def_rw("coverage_distance", &SearchOptions::coverage_distance)
        .def_rw("support_weight", &SearchOptions::support_weight)
        .def_rw("coverage_scale", &SearchOptions::coverage_scale)
        .def_rw("near_penalty", &SearchOptions::near_penalty)
        .def_rw("mismatch_penalty", &SearchOptions::mismatch_penalty)
        .def_rw("normal_penalty", &SearchOptions::normal_penalty)
        .def_rw("solid", &SearchOptions::solid)
        .def_rw("two_way", &SearchOptions::two_way)
        .def_rw("angle_step", &SearchOptions::angle_step)
        .def_rw("beam", &SearchOptions::beam)
        .def_rw("modes", &SearchOptions::modes)
        .def_rw("branch_beam", &SearchOptions::branch_beam)
        .def_rw("threads", &SearchOptions::threads);

    nb::class_<Search> type(m, "Search");
    type.def("__init__",
             [](Search *self, const Articulated &model, const ScanField &field, const SearchOptions &options,
                Doubles neutral) {
        require(int(neutral.shape(0)) == model.joints, "one neutral value per joint is needed");
        new (self) Search(model, field, options, {neutral.data(), neutral.data() + neutral.shape(0)});
    },
             "model"_a, "field"_a, "options"_a, "neutral"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
    type.def("set_prior",
             [](Search &self, Doubles position, double position_deviation, Doubles turn, double turn_deviation,
                Doubles up, double up_deviation, Doubles region, double region_deviation, Doubles values,
                Doubles inverse_deviations) {
        const size_t k = self.model.joints;
        const auto given = [](const Doubles &array, size_t size) { return array.size() == 0 || array.size() == size; };
        require(given(position, 3) && given(turn, 9) && given(up, 6) && given(region, 6),
                "position (3,), turn (9,), up (6,) and region (6,) may be left out by an empty array");
        require(values.size() == k && inverse_deviations.size() == k,
                "one value and one deviation per joint are needed");
        BasePrior base;
        if (position.size()) {
            std::copy_n(position.data(), 3, base.position.emplace().value);
            base.position->deviation = position_deviation;
        }
        if (turn.size()) {
            std::copy_n(turn.data(), 9, base.turn.emplace().R);
            base.turn->deviation = turn_deviation;
        }
        if (up.size()) {
            std::copy_n(up.data(), 3, base.up.emplace().in_scan);
            std::copy_n(up.data() + 3, 3, base.up->in_base);
            base.up->deviation = up_deviation;
        }
        if (region.size()) {
            std::copy_n(region.data(), 3, base.region.emplace().low);
            std::copy_n(region.data() + 3, 3, base.region->high);
            base.region->deviation = region_deviation;
        }
        self.prior = Prior(self.model, base, {values.data(), values.data() + k},
                           {inverse_deviations.data(), inverse_deviations.data() + k});
    },
             "position"_a, "position_deviation"_a, "turn"_a, "turn_deviation"_a, "up"_a, "up_deviation"_a, "region"_a,
             "region_deviation"_a, "values"_a, "inverse_deviations"_a);
    type.def("look_first", [](Search &self, Bytes marked) {
        require(marked.shape(0) == self.field.points.size(), "one mark per scan point is needed");
        self.look_first({marked.data(), marked.data() + marked.shape(0)});
    }, "marked"_a);
    type.def("base_prior", [](const Search &self, Placements base) {
        require(base.shape(0) == 1, "one base is needed");
        std::vector<double> H(36, 0.), g(6, 0.);
        self.prior.base.add(read_placement(base.data()), 1, H.data(), g.data());
        return nb::make_tuple(to_numpy(std::move(H), {6, 6}), to_numpy(std::move(g)));
    }, "base"_a);
    type.def("part_hypotheses",
             [](const Search &self, Ints parts, std::vector<Ints> points, int anchors, uint64_t seed, int keep,
                Floats point_weights) {
        require(points.size() == parts.shape(0), "each part needs the points that it is looked for in");
        std::vector<int> wanted(parts.data(), parts.data() + parts.shape(0));
        for (int p : wanted) require_surface(self.model, p);
        require(point_weights.shape(0) == self.field.points.size(), "one weight per scan point is needed");
        std::vector<std::vector<int>> sampled;
        for (const Ints &own : points) {
            sampled.emplace_back(own.data(), own.data() + own.shape(0));
            for (int k : sampled.back()) require(k >= 0 && k < int(self.field.points.size()), "no such scan point");
        }
        const std::vector<float> weights(point_weights.data(), point_weights.data() + point_weights.shape(0));
        auto found = unlocked([&] { return self.part_hypotheses(wanted, sampled, anchors, seed, keep, weights); });
        return write_hypotheses(found);
    },
             "parts"_a, "points"_a, "anchors"_a, "seed"_a, "keep"_a, "point_weights"_a);
    type.def("correspondence_hypotheses",
             [](const Search &self, int part, Points source, Points source_normals, Points target,
                Points target_normals, Floats weights, uint64_t seed, int keep) {
        const size_t count = source.shape(0);
        require_surface(self.model, part);
        require(source_normals.shape(0) == count && target.shape(0) == count && target_normals.shape(0) == count &&
                    weights.shape(0) == count,
                "the arrays of the correspondences differ in length");
        std::vector<Correspondence> given;
        for (size_t i = 0; i < count; ++i)
            given.push_back({{vectors(source)[i], vectors(source_normals)[i]},
                             {vectors(target)[i], vectors(target_normals)[i]},
                             weights.data()[i]});
        auto found = unlocked([&] { return self.correspondence_hypotheses(part, given, seed, keep); });
        return write_hypotheses(found);
    },
             "part"_a, "source"_a, "source_normals"_a, "target"_a, "target_normals"_a, "weights"_a, "seed"_a, "keep"_a);
    type.def("refine_parts", [](const Search &self, Ints parts, Placements placements, int iterations) {
        auto hypotheses = read_hypotheses(self.model, parts, placements);
        unlocked([&] { self.refine_parts(hypotheses, iterations); });
        return write_hypotheses(hypotheses);
    }, "parts"_a, "placements"_a, "iterations"_a);
    type.def("distinct_parts", [](const Search &self, Ints parts, Placements placements, int keep, float radius) {
        return to_numpy(self.distinct(read_hypotheses(self.model, parts, placements), keep, radius));
    }, "parts"_a, "placements"_a, "keep"_a, "radius"_a);
    type.def("distinct_configurations", [](const Search &self, Placements bases, Matrix values, int keep, float apart) {
        const auto configurations = read_configurations(self.model, bases, values);
        auto kept = unlocked([&] { return self.distinct(configurations, keep, apart); });
        return to_numpy(std::move(kept));
    }, "bases"_a, "values"_a, "keep"_a, "apart"_a);
    type.def("grow", [](const Search &self, Ints parts, Placements placements, int keep) {
        auto roots = read_hypotheses(self.model, parts, placements);
        auto grown = unlocked([&] {
            self.refine_parts(roots, 0);
            return self.grow(roots, keep);
        });
        return write_configurations(self.model, grown);
    }, "parts"_a, "placements"_a, "keep"_a);
    type.def("regrow",
             [](const Search &self, Placements bases, Matrix values, Ints configuration, Ints start, Ints next,
                FloatMatrix weights, int keep) {
        const auto from = read_configurations(self.model, bases, values);
        const size_t count = configuration.shape(0), n = self.model.parts;
        require(start.shape(0) == count && next.shape(0) == count && weights.shape(0) == count && weights.shape(1) == n,
                "the arrays of the tasks differ in length");
        std::vector<RegrowTask> tasks;
        for (size_t t = 0; t < count; ++t) {
            const int c = configuration.data()[t], s = start.data()[t], e = next.data()[t];
            require(c >= 0 && c < int(from.size()) && s >= 0 && s < int(n) && e < int(n),
                    "a task names something that does not exist");
            require(e < 0 || self.model.parent[e] == s || self.model.parent[s] == e, "next is no neighbour of start");
            tasks.push_back({c, s, e, {weights.data() + t * n, weights.data() + (t + 1) * n}});
        }
        auto grown = unlocked([&] { return self.regrow(from, tasks, keep); });
        return write_configurations(self.model, grown);
    },
             "bases"_a, "values"_a, "configuration"_a, "start"_a, "next"_a, "weights"_a, "keep"_a);
    type.def("reach",
             [](const Search &self, Placements bases, Matrix values, Ints configuration, Ints anchor, Ints part,
                Placements placements, uint64_t seed, int starts, int keep, float tolerance) {
        const auto from = read_configurations(self.model, bases, values);
        const size_t count = configuration.shape(0);
        require(anchor.shape(0) == count && part.shape(0) == count && placements.shape(0) == count,
                "the arrays of the tasks differ in length");
        std::vector<ReachTask> tasks;
        for (size_t t = 0; t < count; ++t) {
            const int c = configuration.data()[t], a = anchor.data()[t], p = part.data()[t];
            require(c >= 0 && c < int(from.size()) && a >= 0 && a < self.model.parts && p >= 0 && p < self.model.parts,
                    "a task names something that does not exist");
            require(self.model.surface[p].exists, "a part without a surface cannot be placed");
            tasks.push_back({c, a, p, read_placement(placements.data() + 16 * t)});
        }
        auto found = unlocked([&] { return self.reach(from, tasks, seed, starts, keep, tolerance); });
        return write_configurations(self.model, found);
    },
             "bases"_a, "values"_a, "configuration"_a, "anchor"_a, "part"_a, "placements"_a, "seed"_a, "starts"_a,
             "keep"_a, "tolerance"_a);
    type.def("sweep",
             [](const Search &self, Placements bases, Matrix values, Ints configuration, Ints joint, Bytes base_moves,
                Ints with, int keep, float behind) {
        const auto from = read_configurations(self.model, bases, values);
        require(joint.shape(0) == configuration.shape(0) && base_moves.shape(0) == configuration.shape(0) &&
                    with.shape(0) == configuration.shape(0),
                "the arrays of the tasks differ in length");
        std::vector<SweepTask> tasks;
        for (size_t t = 0; t < configuration.shape(0); ++t) {
            const int c = configuration.data()[t], j = joint.data()[t], w = with.data()[t];
            require(c >= 0 && c < int(from.size()) && j >= 0 && j < self.model.joints && w >= -1 &&
                        w < self.model.joints,
                    "a task names something that does not exist");
            tasks.push_back({c, j, base_moves.data()[t] != 0, w});
        }
        auto found = unlocked([&] { return self.sweep(from, tasks, keep, behind); });
        return write_configurations(self.model, found);
    },
             "bases"_a, "values"_a, "configuration"_a, "joint"_a, "base_moves"_a, "with_joint"_a, "keep"_a, "behind"_a);
    type.def("score",
             [](const Search &self, Placements bases, Matrix values, int points,
                const std::vector<float> &coverage_distances) {
        require(points > 0, "a score needs points");
        const auto configurations = read_configurations(self.model, bases, values);
        auto scores = unlocked([&] { return self.score(configurations, points, coverage_distances); });
        nb::list out;
        for (Scores &s : scores)
            out.append(
                nb::make_tuple(to_numpy(std::move(s.total)), to_numpy(std::move(s.coverage)),
                               to_numpy(std::move(s.support), {configurations.size(), size_t(self.model.parts)})));
        return out;
    },
             "bases"_a, "values"_a, "points"_a, "coverage_distances"_a);
    type.def("refine",
             [](const Search &self, Placements bases, Matrix values, int points, int iterations, float sigma_first,
                float sigma_last, float support_weight, FloatMatrix part_weights) {
        auto configurations = read_configurations(self.model, bases, values);
        require(part_weights.shape(0) == configurations.size() && int(part_weights.shape(1)) == self.model.parts,
                "part_weights must be (m, parts)");
        const std::vector<float> weights(part_weights.data(), part_weights.data() + part_weights.size());
        unlocked(
            [&] { self.refine(configurations, points, iterations, sigma_first, sigma_last, support_weight, weights); });
        return write_configurations(self.model, configurations);
    },
             "bases"_a, "values"_a, "points"_a, "iterations"_a, "sigma_first"_a, "sigma_last"_a, "support_weight"_a,
             "part_weights"_a);
    type.def("assign", [](const Search &self, Points points, Placements placements, Bytes mask, float cap) {
        const PlacedParts placed(self.model, placements, mask);
        Assignment a;
        {
            nb::gil_scoped_release release;
            const int64_t count = points.shape(0), block = 1024;
            a.distance.resize(count), a.part.resize(count), a.sample.resize(count);
            parallel_for((count + block - 1) / block, self.options.threads, [&](int64_t b) {
                const int64_t from = b * block, size = std::min(block, count - from);
                const Assignment piece =
                    self.assign({vectors(points) + from, 1, size}, placed.T.data(), placed.used.data(), cap);
                std::copy(piece.distance.begin(), piece.distance.end(), a.distance.begin() + from);
                std::copy(piece.part.begin(), piece.part.end(), a.part.begin() + from);
                std::copy(piece.sample.begin(), piece.sample.end(), a.sample.begin() + from);
            });
        }
        return write_assignment(std::move(a));
    }, "points"_a, "placements"_a, "mask"_a, "cap"_a);
    type.def("owners", [](const Search &self, Placements placements, Bytes mask, float cap) {
        const PlacedParts placed(self.model, placements, mask);
        auto a = unlocked([&] { return self.owners(placed.T.data(), placed.used.data(), cap); });
        return write_assignment(std::move(a));
    }, "placements"_a, "mask"_a, "cap"_a);
    type.def("facing", [](const Search &self, Points normals, Placements placements, Ints part, Ints sample) {
        const size_t count = normals.shape(0);
        require(int(placements.shape(0)) == self.model.parts && part.shape(0) == count && sample.shape(0) == count,
                "one placement per part, one part and one sample per normal are needed");
        std::vector<RigidF> F;
        for (int p = 0; p < self.model.parts; ++p) F.push_back(to_float(read_placement(placements.data() + 16 * p)));
        std::vector<float> cosines(count, 0.f);
        for (size_t i = 0; i < count; ++i)
            if (const int p = part.data()[i]; p >= 0) {
                require(p < self.model.parts && sample.data()[i] >= 0 &&
                            size_t(sample.data()[i]) < self.model.surface[p].dense.size(),
                        "a normal names a part or a sample that does not exist");
                cosines[i] = dot(rotate(F[p], self.model.surface[p].dense[sample.data()[i]].n), vectors(normals)[i]);
            }
        return to_numpy(std::move(cosines));
    }, "normals"_a, "placements"_a, "part"_a, "sample"_a);
    type.def("distances",
             [](const Search &self, Points points, Placements placements, Bytes mask, float cap, bool loosely) {
        const size_t n = self.model.parts;
        require(placements.shape(0) % n == 0 && mask.shape(0) == n, "one placement per part is needed");
        const std::vector<Rigid> T = read_placements(placements);
        std::vector<uint8_t> used;
        for (size_t p = 0; p < n; ++p) used.push_back(mask.data()[p] && self.model.surface[p].exists);
        const size_t count = T.size() / n;
        std::vector<float> out(count * points.shape(0));
        {
            nb::gil_scoped_release release;
            self.distances({vectors(points), 1, int64_t(points.shape(0))}, T, int64_t(count), used.data(), cap, loosely,
                           out.data());
        }
        return to_numpy(std::move(out), {count, points.shape(0)});
    }, "points"_a, "placements"_a, "mask"_a, "cap"_a, "loosely"_a);
    type.def("in_sight", [](const Search &self, Placements placements, float distance, float cosine) {
        const std::vector<Rigid> T = part_placements(self.model, placements);
        Search::Sight sight = self.in_sight(T, distance, cosine);
        return nb::make_tuple(to_numpy(std::move(sight.shown)), to_numpy(std::move(sight.near)),
                              to_numpy(std::move(sight.confirmed)));
    }, "placements"_a, "distance"_a, "cosine"_a);
    type.def("normal_equations",
             [](const Search &self, Placements placements, Points points, Points normals, float sigma, float cap,
                float support_weight, Floats part_weights, bool along_rays) {
        const size_t n = self.model.parts;
        require(part_weights.shape(0) == n, "one weight per part is needed");
        const std::vector<Rigid> T = part_placements(self.model, placements);
        require(points.shape(0) == normals.shape(0) && points.shape(0) > 0, "points and normals differ in length");
        std::vector<OrientedPoint> sampled;
        for (size_t i = 0; i < points.shape(0); ++i) sampled.push_back({vectors(points)[i], vectors(normals)[i]});
        std::vector<Normal> normal;
        std::vector<int> counts;
        unlocked([&] {
            normal =
                self.normal_equations(sampled, T, sigma, cap, support_weight, part_weights.data(), along_rays, counts);
        });
        std::vector<double> H, g;
        for (const Normal &part : normal) H.insert(H.end(), part.H, part.H + 36), g.insert(g.end(), part.g, part.g + 6);
        return nb::make_tuple(to_numpy(std::move(H), {n, 6, 6}), to_numpy(std::move(g), {n, 6}),
                              to_numpy(std::move(counts)));
    },
             "placements"_a, "points"_a, "normals"_a, "sigma"_a, "cap"_a, "support_weight"_a, "part_weights"_a,
             "along_rays"_a);
}

} // namespace pwr
