// SPDX-License-Identifier: GPL-3.0-or-later
// Independent pieces of work on all cores: the same result on any number of them.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <numeric>
#include <thread>
#include <vector>

#include "dynamorph/core/progress.hpp"
#include "dynamorph/core/types.hpp"

namespace dynamorph {

/// How many cores this process may use: a farm's scheduler gives fewer than the machine has, and so may `set_threads`.
int usable_cores();

/// At most so many cores from now on; 0: all that the system gives.
void set_threads(int most);

/// work(i, progress) for i = 0..count-1, each with a progress of its own that asks to stop once a work has failed. The
/// caller's `progress` hears the mean and is called from the calling thread alone. Rethrows what a work threw. Where
/// the system gives fewer threads than cores, those it gives do all the work; where none, the calling thread.
template <class Work>
void run_tasks(int count, const ProgressFn& progress, const Work& work) {
  std::vector<std::atomic<double>> done(count);
  std::vector<std::exception_ptr> errors(count);
  std::atomic<int> next{0};
  std::atomic<bool> stop{false};
  std::mutex mutex;
  std::condition_variable ended;
  std::exception_ptr cancelled;
  const auto take = [&](const auto& heard) {
    for (int i; (i = next++) < count && !stop;) try {
        work(i, [&, i](double fraction) {
          done[i] = fraction;
          heard();
          return !stop;
        });
      } catch (const Cancelled&) {  // told to stop: the caller's wish or another's error is the reason
        stop = true;
      } catch (...) {
        errors[i] = std::current_exception();
        stop = true;
      }
  };
  const auto tell = [&] {  // the caller
    try {
      if (!cancelled) report(progress, std::accumulate(done.begin(), done.end(), 0.0) / count);
    } catch (...) {
      cancelled = std::current_exception();
      stop = true;
    }
  };

  const int wanted = std::clamp(usable_cores(), 1, std::max(count, 1));
  int ended_threads = 0;
  std::vector<std::thread> threads;
  threads.reserve(wanted);
  try {
    while (int(threads.size()) < wanted)
      threads.emplace_back([&] {
        take([] {});
        const std::lock_guard lock(mutex);
        ++ended_threads;
        ended.notify_one();
      });
  } catch (const std::exception&) {  // the system has no more
    if (threads.empty()) take(tell);
  }
  std::unique_lock lock(mutex);
  while (!ended.wait_for(lock, std::chrono::milliseconds(20), [&] { return ended_threads == int(threads.size()); })) {
    lock.unlock();
    tell();
    lock.lock();
  }
  lock.unlock();
  for (std::thread& thread : threads) thread.join();
  if (cancelled) std::rethrow_exception(cancelled);
  for (const std::exception_ptr& error : errors)
    if (error) std::rethrow_exception(error);
}

/// work(i) for i = 0..count-1 in loops that take a millisecond: by the calling thread, and by threads kept for this as
/// far as they come in time. Nothing is reported and nothing may be thrown.
void parallel_for(int count, const std::function<void(int)>& work);

}  // namespace dynamorph
