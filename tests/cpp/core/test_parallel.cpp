// SPDX-License-Identifier: GPL-3.0-or-later
// Work on all cores: everything is done once, and what went wrong is what the caller hears.
#include <doctest/doctest.h>

#include <cerrno>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/core/parallel.hpp"
#include "dynamorph/core/progress.hpp"

#ifdef __GLIBC__
#include <dlfcn.h>
#include <pthread.h>
#endif

using namespace dynamorph;

#ifdef __GLIBC__

static std::atomic<int> threads_left{1 << 30};  ///< that the system gives

// Every thread of the program is made here.
extern "C" int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*start)(void*), void* data) {
  if (--threads_left < 0) return EAGAIN;
  using Create = decltype(&pthread_create);
  static const auto create = reinterpret_cast<Create>(dlsym(RTLD_NEXT, "pthread_create"));
  return create(thread, attributes, start, data);
}

TEST_CASE("where the system gives fewer threads than there are cores, those there are do the work") {
  struct Restore {
    ~Restore() { threads_left = 1 << 30; }
  } restore;
  for (int given : {0, 1}) {
    const auto all_done = [&](int count) {
      std::vector<int> done(count);
      int heard = 0;
      threads_left = given;
      const auto listen = [&](double fraction) {
        CHECK((fraction >= 0 && fraction <= 1));
        return ++heard > 0;
      };
      run_tasks(count, listen, [&](int i, const ProgressFn& progress) {
        report(progress, 0.5);
        if (given > 0) std::this_thread::sleep_for(std::chrono::milliseconds(5));
        ++done[i];
      });
      CHECK(heard > 0);
      return done == std::vector<int>(count, 1);
    };
    CHECK(all_done(20));
    const auto failing = [](int i, const ProgressFn&) {
      if (i == 1) throw Error("this one");
    };
    threads_left = given;
    CHECK_THROWS_WITH_AS(run_tasks(20, {}, failing), "this one", Error);
    const auto endless = [](int, const ProgressFn& progress) {
      for (;;) report(progress, 0);
    };
    threads_left = given;
    CHECK_THROWS_AS(run_tasks(3, [](double) { return false; }, endless), Cancelled);
    threads_left = given;
    CHECK_THROWS_AS(run_tasks(3, [](double) -> bool { throw Error("no"); }, endless), Error);

    threads_left = given;
    std::vector<int> done(50);
    parallel_for(50, [&](int i) { ++done[i]; });
    CHECK(done == std::vector<int>(50, 1));
  }
}

#endif

TEST_CASE("every piece of work is done once, whatever the number of threads") {
  std::vector<int> done(100);
  run_tasks(100, {}, [&](int i, const ProgressFn& progress) {
    report(progress, 0.5);
    ++done[i];
  });
  CHECK(done == std::vector<int>(100, 1));
}

TEST_CASE("an error is rethrown, not what it stopped") {
  const auto work = [](int i, const ProgressFn& progress) {
    if (i == 1) throw Error("this one");
    for (int k = 0; k < 100; ++k) {  // until it must stop; on one core it ends by itself
      report(progress, 0);
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  };
  CHECK_THROWS_WITH_AS(run_tasks(2, {}, work), "this one", Error);
}

TEST_CASE("false from progress stops the work, and its exceptions pass") {
  const auto endless = [](int, const ProgressFn& progress) {
    for (;;) report(progress, 0);
  };
  CHECK_THROWS_AS(run_tasks(3, [](double) { return false; }, endless), Cancelled);
  CHECK_THROWS_AS(run_tasks(3, [](double) -> bool { throw Error("no"); }, endless), Error);
}

TEST_CASE("chunks are all done once, from several threads at a time and one loop after another") {
  const auto many = [] {
    for (int loop = 0; loop < 200; ++loop) {
      std::vector<int> done(loop % 50);
      parallel_for(int(done.size()), [&](int i) { ++done[i]; });
      if (done != std::vector<int>(done.size(), 1)) return false;
    }
    return true;
  };
  bool other = false;
  std::thread thread([&] { other = many(); });
  CHECK(many());
  thread.join();
  CHECK(other);
}

TEST_CASE("tasks that run tasks share the cores") {
  const int cores = usable_cores();
  for (const int count : {1, 2, 3 * cores}) {
    std::atomic<int> busy{0}, most{0}, done{0};
    run_tasks(count, {}, [&](int, const ProgressFn&) {
      CHECK(usable_cores() == std::max(1, cores / std::min(cores, count)));
      run_tasks(4, {}, [&](int, const ProgressFn&) {
        int now = ++busy, before = most;
        while (now > before && !most.compare_exchange_weak(before, now)) {
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        --busy;
        ++done;
      });
    });
    CHECK(done == 4 * count);
    CHECK(most <= cores);
  }
  CHECK(usable_cores() == cores);
}

TEST_CASE("a limit on the threads holds for both kinds of work, and can be raised again") {
  const auto most_at_once = [](auto&& loop) {
    std::atomic<int> now{0}, most{0};
    loop([&](int) {
      const int together = ++now;
      for (int seen = most; seen < together && !most.compare_exchange_weak(seen, together);) {
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      --now;
    });
    return int(most);
  };
  for (int limit : {1, 2, 0}) {
    set_threads(limit);
    CHECK(usable_cores() >= 1);
    if (limit) CHECK(usable_cores() <= limit);
    CHECK(most_at_once([](const auto& work) { parallel_for(20, work); }) <= usable_cores());
    CHECK(most_at_once([](const auto& work) { run_tasks(20, {}, [&](int i, const ProgressFn&) { work(i); }); }) <=
          usable_cores());
  }
  CHECK_THROWS_AS(set_threads(-1), std::invalid_argument);
}
