// Independent items over a bounded number of threads. Every item writes only its own output, so results do not depend
// on the number of threads.
#pragma once
#include <atomic>
#include <cstdint>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace pwr {

template <typename Function> void parallel_for(int64_t count, int threads, Function &&item) {
    const int64_t workers = std::min<int64_t>(threads, count);
    if (workers <= 1) {
        for (int64_t i = 0; i < count; ++i) item(i);
        return;
    }
    std::atomic<int64_t> next{0};
    std::vector<std::exception_ptr> failures(workers);
    auto work = [&](int64_t worker) {
        try {
            for (int64_t i = next++; i < count; i = next++) item(i);
        } catch (...) {
            failures[worker] = std::current_exception();
        }
    };
    std::vector<std::thread> pool;
    pool.reserve(workers - 1);
    try {
        for (int64_t w = 1; w < workers; ++w) pool.emplace_back(work, w);
    } catch (const std::system_error &) {
        // The system gives no more threads: those that there are do it all.
    }
    work(0);
    for (auto &thread : pool) thread.join();
    for (auto &failure : failures)
        if (failure) std::rethrow_exception(failure);
}

// splitmix64: a small generator whose stream depends on the seed alone.
class Random {
  public:
    explicit Random(uint64_t seed) : state(seed) {}
    uint64_t next() {
        uint64_t z = (state += 0x9E3779B97F4A7C15ull);
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
        return z ^ (z >> 31);
    }
    uint32_t below(uint32_t n) { return uint32_t((uint64_t(uint32_t(next())) * n) >> 32); }
    double uniform() { return double(next() >> 11) * 0x1.0p-53; }

  private:
    uint64_t state;
};

} // namespace pwr
