// Exact closest points on triangle meshes.
#pragma once
#include "linalg.hpp"

namespace pwr {

class TriangleMesh {
  public:
    // `faces` holds three vertex indices a triangle.
    TriangleMesh(const Vec *vertices, const int *faces, int64_t count);

    // Where a point of the mesh is nearer to `p` than the root of `squared`, put it into `at` and return its squared
    // distance; otherwise return `squared`.
    float closest(Vec p, float squared, Vec &at) const;

  private:
    struct Triangle {
        Vec corner[3];
        Vec middle() const { return (1 / 3.f) * (corner[0] + corner[1] + corner[2]); }
    };
    // A box of the tree: a leaf holds triangles, of any other the first child follows it and `second` is the other.
    struct Box {
        Vec low, high;
        int second, first, count;
    };
    void build(int first, int count);
    static float squared_distance(Vec p, const Box &box);

    std::vector<Triangle> triangles;
    std::vector<Box> boxes;
};

} // namespace pwr
