// The posed model as its sensor sees it: of every pixel of an image one sample of the surface in front.
#pragma once
#include "articulated.hpp"

namespace pwr {

class SeenSurface {
  public:
    // The surfaces of the parts placed by T, seen from `sensor`.
    SeenSurface(const Articulated &model, const std::vector<RigidF> &T, Vec sensor);

    struct Place {
        int part, sample;
    };
    // The seen sample of which the ray through p passes by nearest; part -1 where it passes by the model.
    Place on_ray_to(Vec p) const;

  private:
    struct Pixel {
        float front = 1e30f; // depth of what is foremost here or in a neighbouring pixel
        float off = 1e30f;   // squared distance, in pixels, of the seen sample from the pixel's middle
        Place place{-1, -1};
        float u = 0, v = 0; // of the seen sample, pixels
    };
    struct Projected {
        float u, v, depth;
    };
    Projected project(Vec p) const;
    // Pixels at the rim stay empty, so that every other one has eight neighbours.
    bool inside(Projected at) const {
        return at.depth > 0 && at.u >= 1 && at.v >= 1 && at.u < width - 1 && at.v < height - 1;
    }
    int pixel_at(Projected at) const { return int(at.v) * width + int(at.u); }

    Vec sensor, right, down, forward;
    float pixels_per_tangent = 1, corner_u = 0, corner_v = 0;
    int width = 0, height = 0;
    std::vector<Pixel> pixels;
};

} // namespace pwr
