// The posed model as a distribution of scan points: its surface, blurred by the noise, and strays anywhere.
#pragma once
#include "articulated.hpp"

namespace pwr {

// What scan points say about a placed model and about their noise.
struct MixtureEvidence {
    double log_likelihood = 0;
    std::vector<double> g;      // (n + 1) its derivative by n parameters and by the logarithm of the noise, ...
    std::vector<double> H;      // (n + 1, n + 1) ... and the sum over points of the outer products of theirs
    std::vector<double> part_H; // (parts, 6, 6) the same of each part's twist alone, about the root's origin
    double strays = 0;          // points expected to lie on nothing of the model
};

// A mixture of normal distributions, one for each patch of surface, that has the patch's mean and covariance.
class SurfaceMixture {
  public:
    // Patches are what a cell of side `spacing` holds of a part's surface that faces one way.
    SurfaceMixture(const Articulated &model, float spacing);

    // Weigh patches by what is seen of them from far away in each of the unit directions, the parts being placed by T.
    // Patches that none sees keep the share `unseen` of what all would have by their area.
    void look(const std::vector<Rigid> &T, const std::vector<Vec> &directions, float unseen);

    // The evidence of points whose coordinates have noise of standard deviation `sigma` about the parts placed by T; of
    // all points the share `strays` lies anywhere in `volume`. J (parts, 6, n) maps parameters to the parts' twists
    // about the root's origin.
    MixtureEvidence evidence(const std::vector<Vec> &points, const std::vector<Rigid> &T, const double *J, int n,
                             float sigma, float strays, float volume, int threads) const;

    const Articulated &model;

  private:
    struct Patch {
        int part;
        float area, weight;  // weights sum to 1
        Vec mean, normal;    // in the part's frame
        float covariance[6]; // xx xy xz yy yz zz
    };
    std::vector<Patch> patches; // part by part
    float spacing;
};

} // namespace pwr
