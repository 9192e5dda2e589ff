// Small fixed-size linear algebra. Points are float (millions of them), placements double (few, composed along chains).
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace pwr {

struct Vec {
    float x, y, z;
};
inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec operator*(float s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }
inline float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline float norm(Vec a) { return std::sqrt(dot(a, a)); }
inline double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// One number for the cell (x, y, z) of a grid, in whose order its neighbours along z follow; 21 bits a side.
inline uint64_t pack_cell(int64_t x, int64_t y, int64_t z) {
    const int64_t bias = 1 << 20;
    return (uint64_t(x + bias) << 42) | (uint64_t(y + bias) << 21) | uint64_t(z + bias);
}

// A rigid placement: rotation (row major) and translation.
template <typename T> struct RigidT {
    T R[9];
    T t[3];
    static RigidT identity() { return {{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}}; }
};
using Rigid = RigidT<double>;
using RigidF = RigidT<float>;

inline RigidF to_float(const Rigid &A) {
    RigidF B;
    for (int i = 0; i < 9; ++i) B.R[i] = float(A.R[i]);
    for (int i = 0; i < 3; ++i) B.t[i] = float(A.t[i]);
    return B;
}
inline Rigid operator*(const Rigid &A, const Rigid &B) {
    Rigid C;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
            C.R[3 * i + j] = A.R[3 * i] * B.R[j] + A.R[3 * i + 1] * B.R[3 + j] + A.R[3 * i + 2] * B.R[6 + j];
        C.t[i] = A.R[3 * i] * B.t[0] + A.R[3 * i + 1] * B.t[1] + A.R[3 * i + 2] * B.t[2] + A.t[i];
    }
    return C;
}
inline Rigid inverse(const Rigid &A) {
    Rigid B;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) B.R[3 * i + j] = A.R[3 * j + i];
        B.t[i] = -(A.R[i] * A.t[0] + A.R[3 + i] * A.t[1] + A.R[6 + i] * A.t[2]);
    }
    return B;
}
inline Vec apply(const RigidF &A, Vec p) {
    return {A.R[0] * p.x + A.R[1] * p.y + A.R[2] * p.z + A.t[0], A.R[3] * p.x + A.R[4] * p.y + A.R[5] * p.z + A.t[1],
            A.R[6] * p.x + A.R[7] * p.y + A.R[8] * p.z + A.t[2]};
}
inline Vec rotate(const RigidF &A, Vec p) {
    return {A.R[0] * p.x + A.R[1] * p.y + A.R[2] * p.z, A.R[3] * p.x + A.R[4] * p.y + A.R[5] * p.z,
            A.R[6] * p.x + A.R[7] * p.y + A.R[8] * p.z};
}
inline Vec apply_inverse(const RigidF &A, Vec p) {
    const float x = p.x - A.t[0], y = p.y - A.t[1], z = p.z - A.t[2];
    return {A.R[0] * x + A.R[3] * y + A.R[6] * z, A.R[1] * x + A.R[4] * y + A.R[7] * z,
            A.R[2] * x + A.R[5] * y + A.R[8] * z};
}

// Rodrigues' formula: rotation by `angle` about the unit `axis`.
inline void rotation_about(const double *axis, double angle, double *R) {
    const double x = axis[0], y = axis[1], z = axis[2], c = std::cos(angle), s = std::sin(angle), o = 1 - c;
    R[0] = c + x * x * o, R[1] = x * y * o - z * s, R[2] = x * z * o + y * s;
    R[3] = y * x * o + z * s, R[4] = c + y * y * o, R[5] = y * z * o - x * s;
    R[6] = z * x * o - y * s, R[7] = z * y * o + x * s, R[8] = c + z * z * o;
}

// The rotation vector (world axes) that turns A onto B, that of B A^T.
inline void turn_between(const double *A, const double *B, double *w) {
    double R[9];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            R[3 * i + j] = B[3 * i] * A[3 * j] + B[3 * i + 1] * A[3 * j + 1] + B[3 * i + 2] * A[3 * j + 2];
    w[0] = (R[7] - R[5]) / 2, w[1] = (R[2] - R[6]) / 2, w[2] = (R[3] - R[1]) / 2;
    const double sine = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), cosine = (R[0] + R[4] + R[8] - 1) / 2;
    for (int i = 0; i < 3; ++i) w[i] *= sine > 1e-9 ? std::atan2(sine, cosine) / sine : 1;
    // At half a turn the axis is lost; any serves, since what is so far off is not near to right.
    if (sine <= 1e-9 && cosine < 0) w[0] = M_PI;
}

inline void orthonormalise(double *R) {
    auto normalise = [](double *v) {
        const double n = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        for (int i = 0; i < 3; ++i) v[i] /= n;
    };
    normalise(R);
    const double d = R[0] * R[3] + R[1] * R[4] + R[2] * R[5];
    for (int i = 0; i < 3; ++i) R[3 + i] -= d * R[i];
    normalise(R + 3);
    R[6] = R[1] * R[5] - R[2] * R[4], R[7] = R[2] * R[3] - R[0] * R[5], R[8] = R[0] * R[4] - R[1] * R[3];
}

// Move a placement by a world twist whose rotation acts about the placement's own origin; the angle is clamped.
inline double retract(Rigid &A, const double *twist, double max_angle) {
    double w[3] = {twist[0], twist[1], twist[2]}, v[3] = {twist[3], twist[4], twist[5]};
    double angle = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
    if (angle > max_angle) {
        for (int i = 0; i < 3; ++i) w[i] *= max_angle / angle, v[i] *= max_angle / angle;
        angle = max_angle;
    }
    if (angle > 1e-12) {
        const double axis[3] = {w[0] / angle, w[1] / angle, w[2] / angle};
        Rigid turn = Rigid::identity(), spun;
        rotation_about(axis, angle, turn.R);
        const double t[3] = {A.t[0], A.t[1], A.t[2]};
        spun = turn * A;
        std::copy(spun.R, spun.R + 9, A.R);
        std::copy(t, t + 3, A.t);
    }
    for (int i = 0; i < 3; ++i) A.t[i] += v[i];
    return angle;
}

// Normal equations of one rigid part in twist space (rotation, translation; world axes, about a common point).
struct Normal {
    double H[36] = {};
    double g[6] = {};

    // Residual along the normal n of a point at arm r from the reference point, weight w (point to plane).
    void add_plane(Vec r, Vec n, float residual, float w) {
        const Vec m = cross(r, n);
        const float a[6] = {m.x, m.y, m.z, n.x, n.y, n.z};
        // Whole rows of the first four columns at a time: what is below the diagonal is overwritten by `mirror`.
        using Floats = float __attribute__((vector_size(16)));
        using Doubles = double __attribute__((vector_size(32)));
        const Floats first{a[0], a[1], a[2], a[3]};
        for (int i = 0; i < 6; ++i) {
            const float wa = w * a[i];
            g[i] += wa * residual;
            if (i < 4) {
                Doubles row;
                std::memcpy(&row, &H[6 * i], sizeof(row));
                row += __builtin_convertvector(wa * first, Doubles);
                std::memcpy(&H[6 * i], &row, sizeof(row));
            }
            for (int j = std::max(i, 4); j < 6; ++j) H[6 * i + j] += wa * a[j];
        }
    }
    // Residual vector d of a point at arm r, weight w (point to point).
    void add_point(Vec r, Vec d, float w) {
        const Vec m = cross(r, d);
        g[0] += w * m.x, g[1] += w * m.y, g[2] += w * m.z, g[3] += w * d.x, g[4] += w * d.y, g[5] += w * d.z;
        H[0] += w * (r.y * r.y + r.z * r.z), H[7] += w * (r.x * r.x + r.z * r.z), H[14] += w * (r.x * r.x + r.y * r.y);
        H[1] -= w * r.x * r.y, H[2] -= w * r.x * r.z, H[8] -= w * r.y * r.z;
        H[4] -= w * r.z, H[5] += w * r.y, H[9] += w * r.z, H[11] -= w * r.x, H[15] -= w * r.y, H[16] += w * r.x;
        H[21] += w, H[28] += w, H[35] += w;
    }
    void add(const Normal &other) {
        for (int i = 0; i < 36; ++i) H[i] += other.H[i];
        for (int i = 0; i < 6; ++i) g[i] += other.g[i];
    }
    void mirror() {
        for (int i = 0; i < 6; ++i)
            for (int j = 0; j < i; ++j) H[6 * i + j] = H[6 * j + i];
    }
};

// Solve the symmetric positive definite system A x = b of size n in place; false if A is not definite. The last
// unknowns are eliminated first: where they are joints in the order of a tree, branches that share no joint stay apart.
inline bool solve_spd(double *A, double *b, int n) {
    for (int j = n - 1; j >= 0; --j) {
        const double *row = &A[j * n];
        if (!(row[j] > 0)) return false;
        const double inverse = 1 / row[j];
        for (int i = 0; i < j; ++i) {
            const double share = row[i] * inverse;
            if (share == 0) continue;
            b[i] -= share * b[j];
            for (int k = 0; k <= i; ++k) A[i * n + k] -= share * row[k];
        }
    }
    for (int j = 0; j < n; ++j) {
        for (int k = 0; k < j; ++k) b[j] -= A[j * n + k] * b[k];
        b[j] /= A[j * n + j];
    }
    return true;
}

// Eigenvalues (ascending) and eigenvectors (columns) of a symmetric 3x3 matrix: cyclic Jacobi.
inline void eigen_symmetric(double A[3][3], double values[3], double V[3][3]) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) V[i][j] = i == j;
    for (int sweep = 0; sweep < 12; ++sweep) {
        const double off = A[0][1] * A[0][1] + A[0][2] * A[0][2] + A[1][2] * A[1][2];
        if (off < 1e-30) break;
        for (int p = 0; p < 2; ++p)
            for (int q = p + 1; q < 3; ++q) {
                if (std::abs(A[p][q]) < 1e-300) continue;
                const double theta = (A[q][q] - A[p][p]) / (2 * A[p][q]);
                const double t = (theta >= 0 ? 1 : -1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
                const double c = 1 / std::sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 3; ++k) {
                    const double a = A[k][p], b = A[k][q];
                    A[k][p] = c * a - s * b, A[k][q] = s * a + c * b;
                }
                for (int k = 0; k < 3; ++k) {
                    const double a = A[p][k], b = A[q][k];
                    A[p][k] = c * a - s * b, A[q][k] = s * a + c * b;
                }
                for (int k = 0; k < 3; ++k) {
                    const double a = V[k][p], b = V[k][q];
                    V[k][p] = c * a - s * b, V[k][q] = s * a + c * b;
                }
            }
    }
    int order[3] = {0, 1, 2};
    std::sort(order, order + 3, [&](int a, int b) { return A[a][a] < A[b][b]; });
    double U[3][3];
    for (int j = 0; j < 3; ++j) {
        values[j] = A[order[j]][order[j]];
        for (int i = 0; i < 3; ++i) U[i][j] = V[i][order[j]];
    }
    std::memcpy(V, U, sizeof(U));
}

} // namespace pwr
