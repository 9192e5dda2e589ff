// Exact closest points on triangle meshes.
#pragma once
#include "lanes.hpp"

namespace pwr {

class TriangleMesh {
  public:
    // `faces` holds three vertex indices a triangle.
    TriangleMesh(const Vec *vertices, const int *faces, int64_t count);

    // Where a point of the mesh is nearer to `p` than the root of `squared`, put it into `at` and return its squared
    // distance; otherwise return `squared`.
    float closest(Vec p, float squared, Vec &at) const;

    // A ball that holds the mesh; of radius -inf if there is none.
    Vec middle{0, 0, 0};
    float radius = -INFINITY;

  private:
    struct Triangle {
        Vec corner[3];
        Vec middle() const { return (1 / 3.f) * (corner[0] + corner[1] + corner[2]); }
    };
    // Triangles side by side; the last is repeated where there are fewer.
    struct Leaf {
        VecLanes corner[3];
    };
    // Boxes side by side, each with what it holds: a node, or, counted from -1 down, a leaf. Lanes without a box are
    // infinitely far.
    struct Node {
        VecLanes low, high;
        int inside[lane_count];
    };
    int build(std::vector<Triangle> &triangles, int first, int count);
    static FloatLanes squared_distances(Vec p, const Node &node);

    std::vector<Leaf> leaves;
    std::vector<Node> nodes; // the first is the root's
};

// Move points to the closest points of placed meshes, within `reach`, and tell whose they are; -1 for those that stay.
void closest_on_meshes(const std::vector<const TriangleMesh *> &meshes, const std::vector<Rigid> &T, float reach,
                       int threads, std::vector<Vec> &points, std::vector<int> &owner);

} // namespace pwr
