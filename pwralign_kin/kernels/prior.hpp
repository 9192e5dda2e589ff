// What is known before the scan is looked at, as the search uses it. Lengths are in units of the model's diagonal.
#pragma once
#include "articulated.hpp"
#include <optional>

namespace pwr {

// What is known of the base; each term may be missing, and each has a standard deviation.
struct BasePrior {
    struct Position {
        double value[3], deviation;
    };
    struct Turn {
        double R[9], deviation;
    };
    struct Direction {
        double in_scan[3], in_base[3], deviation;
    };
    struct Box {
        double low[3], high[3], deviation; // deviation: of the distance outside
    };
    std::optional<Position> position;
    std::optional<Turn> turn;
    std::optional<Direction> up;
    std::optional<Box> region;

    bool says_something() const { return position || turn || up || region; }
    // The largest deviation of a base from what is known, in standard deviations.
    double deviation(const Rigid &base) const;
    // Add the terms to normal equations in twist space about the base's origin.
    void add(const Rigid &base, double weight, double *H, double *g) const;
    // The same with larger deviations.
    BasePrior widened(double distance, double angle) const;
};

// Whether a base is within so many deviations of what is known, told by squares and cosines: this is asked for every
// base that each hypothesis leaves possible.
struct Bounds {
    BasePrior known;
    double position = 0, region = 0; // squared distances
    double turn = -1, up = -1;       // cosines
    Bounds(const BasePrior &known, double deviations);
    bool hold(const Rigid &base) const;
};

struct Prior {
    static constexpr double free_deviations = 3;
    BasePrior base;
    BasePrior loose; // the same within what the search can place before it refines
    // Of the joints: believed values and one over their standard deviations, 0 where nothing is believed.
    std::vector<double> values, inverse_deviations;
    // Bases that each part can have in its own frame, drawn over the joint limits; empty where nothing is known of the
    // base. The drawn bases stand some way apart, farther the more joints lie between: `wide` makes up for that.
    std::vector<std::vector<Rigid>> bases_in_part;
    std::vector<Bounds> wide; // per part

    Prior() = default;
    Prior(const Articulated &model, BasePrior base, std::vector<double> values, std::vector<double> inverse_deviations);
    // What a configuration costs in the two-way score.
    float cost(const Rigid &base, const std::vector<double> &joints) const;
    float base_cost(const Rigid &base) const;
    float joint_cost(int joint, double value) const;
    // Whether some joint values bring a placed part's base near what is known.
    bool reachable(int part, const Rigid &T) const;
};

} // namespace pwr
