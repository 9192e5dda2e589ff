// Eight numbers at a time, by the vector types of GCC and Clang: arithmetic and comparisons go lane by lane, a
// condition is -1 or 0 a lane, and `condition ? a : b` chooses lane by lane.
#pragma once
#include "linalg.hpp"

// The lanes of two vectors in another order, under a name of GCC's that is older than the one of Clang's.
#ifdef __clang__
#define PWR_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define PWR_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, pwr::IntLanes{__VA_ARGS__})
#endif

namespace pwr {

constexpr int lane_count = 8;
using FloatLanes = float __attribute__((vector_size(4 * lane_count)));
using IntLanes = int32_t __attribute__((vector_size(4 * lane_count)));

inline FloatLanes load_lanes(const float *from) {
    FloatLanes out;
    std::memcpy(&out, from, sizeof(out));
    return out;
}
inline IntLanes load_lanes(const int *from) {
    IntLanes out;
    std::memcpy(&out, from, sizeof(out));
    return out;
}
template <typename Lanes, typename Number> void store_lanes(Lanes lanes, Number *to) {
    std::memcpy(to, &lanes, sizeof(lanes));
}
inline FloatLanes all_lanes(float value) { return FloatLanes{} + value; }
inline FloatLanes max_lanes(FloatLanes a, FloatLanes b) { return a > b ? a : b; }
inline FloatLanes abs_lanes(FloatLanes a) { return max_lanes(a, -a); }
inline bool any_lane(IntLanes condition) {
    int64_t words[lane_count / 2];
    std::memcpy(words, &condition, sizeof(words));
    return words[0] | words[1] | words[2] | words[3];
}
// The lanes in which a condition holds, a bit each.
inline unsigned bits_of_lanes(IntLanes condition) {
#ifdef __AVX__
    FloatLanes signs;
    std::memcpy(&signs, &condition, sizeof(signs));
    return unsigned(__builtin_ia32_movmskps256(signs));
#else
    unsigned bits = 0;
    for (int j = 0; j < lane_count; ++j) bits |= unsigned(condition[j] & 1) << j;
    return bits;
#endif
}
// Call f(lane) for every lane in which the condition holds.
template <typename F> void for_lanes(IntLanes condition, F &&f) {
    for (unsigned bits = bits_of_lanes(condition); bits; bits &= bits - 1) f(__builtin_ctz(bits));
}
// For each of the conditions that eight lanes may hold, the lanes in which they hold, in their order.
struct PackedOrders {
    uint8_t lanes[256][lane_count] = {};
    constexpr PackedOrders() {
        for (int bits = 0; bits < 256; ++bits)
            for (int j = 0, next = 0; j < lane_count; ++j)
                if (bits >> j & 1) lanes[bits][next++] = uint8_t(j);
    }
};
inline constexpr PackedOrders packed_orders;

// Brings the lanes in which a condition holds to the front, in their order; what follows them is anything.
class Packing {
  public:
    explicit Packing(IntLanes condition) {
        const unsigned bits = bits_of_lanes(condition);
        count = __builtin_popcount(bits);
        uint8_t lanes __attribute__((vector_size(lane_count)));
        std::memcpy(&lanes, packed_orders.lanes[bits], sizeof(lanes));
        order = __builtin_convertvector(lanes, IntLanes);
    }
    FloatLanes operator()(FloatLanes a) const {
#ifdef __AVX2__
        return __builtin_ia32_permvarsf256(a, order);
#else
        FloatLanes out{};
        for (int j = 0; j < count; ++j) out[j] = a[order[j]];
        return out;
#endif
    }
    IntLanes operator()(IntLanes a) const {
        FloatLanes bits;
        std::memcpy(&bits, &a, sizeof(a));
        bits = (*this)(bits);
        std::memcpy(&a, &bits, sizeof(a));
        return a;
    }

    int count;

  private:
    IntLanes order;
};
inline FloatLanes sqrt_lanes(FloatLanes a) {
#ifdef __AVX__
    return __builtin_ia32_sqrtps256(a);
#else
    for (int j = 0; j < lane_count; ++j) a[j] = std::sqrt(a[j]);
    return a;
#endif
}
inline float sum_of_lanes(FloatLanes a) {
    float sum = 0;
    for (int j = 0; j < lane_count; ++j) sum += a[j];
    return sum;
}
inline IntLanes first_lanes(int count) { return IntLanes{0, 1, 2, 3, 4, 5, 6, 7} < IntLanes{} + count; }

struct VecLanes {
    FloatLanes x, y, z;
};
inline VecLanes operator-(const VecLanes &a, const VecLanes &b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline VecLanes operator-(Vec a, const VecLanes &b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline VecLanes operator-(const VecLanes &a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline FloatLanes dot(const VecLanes &a, const VecLanes &b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline FloatLanes dot(Vec a, const VecLanes &b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline VecLanes operator*(FloatLanes s, const VecLanes &a) { return {s * a.x, s * a.y, s * a.z}; }
inline VecLanes cross(const VecLanes &a, const VecLanes &b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline VecLanes rotate(const RigidF &A, const VecLanes &p) {
    return {A.R[0] * p.x + A.R[1] * p.y + A.R[2] * p.z, A.R[3] * p.x + A.R[4] * p.y + A.R[5] * p.z,
            A.R[6] * p.x + A.R[7] * p.y + A.R[8] * p.z};
}
inline VecLanes apply(const RigidF &A, const VecLanes &p) {
    const VecLanes r = rotate(A, p);
    return {r.x + A.t[0], r.y + A.t[1], r.z + A.t[2]};
}
inline VecLanes apply_inverse(const RigidF &A, const VecLanes &p) {
    const FloatLanes x = p.x - A.t[0], y = p.y - A.t[1], z = p.z - A.t[2];
    return {A.R[0] * x + A.R[3] * y + A.R[6] * z, A.R[1] * x + A.R[4] * y + A.R[7] * z,
            A.R[2] * x + A.R[5] * y + A.R[8] * z};
}

// What eight residuals at a time add to the normal equations of a part (`Normal`, which says what the arguments are).
// Lanes of weight 0 add nothing.
class NormalLanes {
  public:
    void add_planes(const VecLanes &r, const VecLanes &n, FloatLanes residual, FloatLanes w) {
        const VecLanes m = cross(r, n);
        const FloatLanes a[6] = {m.x, m.y, m.z, n.x, n.y, n.z};
        for (int i = 0, k = 0; i < 6; ++i) {
            const FloatLanes wa = w * a[i];
            g[i] += wa * residual;
            for (int j = i; j < 6; ++j) H[k++] += wa * a[j];
        }
    }
    void add_points(const VecLanes &r, const VecLanes &d, FloatLanes w) {
        const VecLanes m = cross(r, d), s = w * r;
        g[0] += w * m.x, g[1] += w * m.y, g[2] += w * m.z, g[3] += w * d.x, g[4] += w * d.y, g[5] += w * d.z;
        H[0] += s.y * r.y + s.z * r.z, H[6] += s.x * r.x + s.z * r.z, H[11] += s.x * r.x + s.y * r.y;
        H[1] -= s.x * r.y, H[2] -= s.x * r.z, H[7] -= s.y * r.z;
        H[4] -= s.z, H[5] += s.y, H[8] += s.z, H[10] -= s.x, H[12] -= s.y, H[13] += s.x;
        H[15] += w, H[18] += w, H[20] += w;
    }
    void add_to(Normal &normal) const {
        for (int i = 0, k = 0; i < 6; ++i) {
            normal.g[i] += sum_of_lanes(g[i]);
            for (int j = i; j < 6; ++j) normal.H[6 * i + j] += sum_of_lanes(H[k++]);
        }
    }

  private:
    FloatLanes H[21] = {}, g[6] = {}; // H: the rows of the upper triangle
};

// Positions coordinate by coordinate, padded so that `lane_count` may be read from any of them on.
struct SplitPoints {
    std::vector<float> x, y, z;
    int64_t size = 0;

    SplitPoints() = default;
    SplitPoints(const Vec *points, int64_t count, int64_t stride)
        : x(count + lane_count, 0.f), y(count + lane_count, 0.f), z(count + lane_count, 0.f), size(count) {
        for (int64_t i = 0; i < count; ++i)
            x[i] = points[i * stride].x, y[i] = points[i * stride].y, z[i] = points[i * stride].z;
    }
    void clear() { size = 0; }
    void push(Vec p) {
        make_room(1);
        x[size] = p.x, y[size] = p.y, z[size] = p.z, ++size;
    }
    // Those of some others from `first` on and before `last`.
    void push(const SplitPoints &others, int64_t first, int64_t last) {
        make_room(last - first);
        for (; first < last; first += lane_count, size += lane_count) {
            const VecLanes some = others.at(first);
            store_lanes(some.x, &x[size]), store_lanes(some.y, &y[size]), store_lanes(some.z, &z[size]);
        }
        size += last - first;
    }
    VecLanes at(int64_t i) const { return {load_lanes(&x[i]), load_lanes(&y[i]), load_lanes(&z[i])}; }
    // For positions that are not counted, in room made for them.
    void set(int64_t i, Vec p) { x[i] = p.x, y[i] = p.y, z[i] = p.z; }
    void set(int64_t i, const VecLanes &p) {
        store_lanes(p.x, &x[i]), store_lanes(p.y, &y[i]), store_lanes(p.z, &z[i]);
    }
    void make_room(int64_t more) {
        if (size + more + lane_count <= int64_t(x.size())) return;
        const size_t most = 2 * size + more + 4 * lane_count;
        x.resize(most, 0.f), y.resize(most, 0.f), z.resize(most, 0.f);
    }
};

// Points with normals, one after the other and padded, so that any few of them are read by whole loads.
class OrientedRows {
  public:
    void reserve(size_t count) { rows.reserve(count * lane_count); }
    void push(Vec point, Vec normal) {
        const float row[lane_count] = {point.x, point.y, point.z, normal.x, normal.y, normal.z};
        rows.insert(rows.end(), row, row + lane_count);
    }
    void prefetch(int index) const { __builtin_prefetch(&rows[size_t(index) * lane_count]); }
    // Those of some indices.
    __attribute__((always_inline)) void gather(const int *index, VecLanes &point, VecLanes &normal) const {
        auto row = [&](int j) { return load_lanes(&rows[size_t(index[j]) * lane_count]); };
        // The rows become columns: of pairs of rows, of fours, of all.
        auto four = [&](int j) {
            const FloatLanes a = row(j), b = row(j + 1), c = row(j + 2), d = row(j + 3);
            const FloatLanes ab = PWR_SHUFFLE(a, b, 0, 8, 1, 9, 4, 12, 5, 13),
                             cd = PWR_SHUFFLE(c, d, 0, 8, 1, 9, 4, 12, 5, 13);
            const FloatLanes AB = PWR_SHUFFLE(a, b, 2, 10, 3, 11, 6, 14, 7, 15),
                             CD = PWR_SHUFFLE(c, d, 2, 10, 3, 11, 6, 14, 7, 15);
            return Columns{
                PWR_SHUFFLE(ab, cd, 0, 1, 8, 9, 4, 5, 12, 13), PWR_SHUFFLE(ab, cd, 2, 3, 10, 11, 6, 7, 14, 15),
                PWR_SHUFFLE(AB, CD, 0, 1, 8, 9, 4, 5, 12, 13), PWR_SHUFFLE(AB, CD, 2, 3, 10, 11, 6, 7, 14, 15)};
        };
        const Columns low = four(0), high = four(4);
        auto first = [](FloatLanes a, FloatLanes b) { return PWR_SHUFFLE(a, b, 0, 1, 2, 3, 8, 9, 10, 11); };
        auto second = [](FloatLanes a, FloatLanes b) { return PWR_SHUFFLE(a, b, 4, 5, 6, 7, 12, 13, 14, 15); };
        point = {first(low.a, high.a), first(low.b, high.b), first(low.c, high.c)};
        normal = {first(low.d, high.d), second(low.a, high.a), second(low.b, high.b)};
    }

  private:
    struct Columns {
        FloatLanes a, b, c, d;
    };
    std::vector<float> rows;
};

} // namespace pwr
