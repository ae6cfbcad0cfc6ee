// SPDX-License-Identifier: GPL-3.0-or-later
// Runs independent pieces of work on all cores. The result does not depend on the number of cores.
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

/// Number of cores that this thread may use. A scheduler on a farm, or `set_threads`, may allow fewer than the machine
/// has, and a task has its share of them.
int usable_cores();

/// The share of a task's thread; 0 in others.
inline thread_local int cores_of_task = 0;

/// Limits how many cores are used from now on; 0 means all that the system gives.
void set_threads(int limit);

/// Calls work(i, progress) for i = 0..count-1. Each call has its own progress, which asks it to stop once another call
/// has failed. The caller's `progress` gets the mean and is called only from the calling thread. Rethrows what a call
/// threw. If the system gives fewer threads than cores, those threads do all the work; if it gives none, the calling
/// thread does. Tasks may run tasks.
template <class Work>
void run_tasks(int count, const ProgressFn& progress, const Work& work) {
  std::vector<std::atomic<double>> done(count);
  std::vector<std::exception_ptr> errors(count);
  std::atomic<int> next{0};
  std::atomic<bool> stop{false};
  std::mutex mutex;
  std::condition_variable ended;
  std::exception_ptr canceled;
  const auto take = [&](const auto& notify) {
    for (int i; (i = next++) < count && !stop;) try {
        work(i, [&, i](double fraction) {
          done[i] = fraction;
          notify();
          return !stop;
        });
      } catch (const Cancelled&) {  // asked to stop, because the caller canceled or another call failed
        stop = true;
      } catch (...) {
        errors[i] = std::current_exception();
        stop = true;
      }
  };
  const auto report_mean = [&] {  // to the caller
    try {
      if (!canceled) report(progress, std::accumulate(done.begin(), done.end(), 0.0) / count);
    } catch (...) {
      canceled = std::current_exception();
      stop = true;
    }
  };

  const int cores = std::max(usable_cores(), 1), wanted = std::clamp(cores, 1, std::max(count, 1));
  int ended_threads = 0;
  std::vector<std::thread> threads;
  threads.reserve(wanted);
  try {
    while (int(threads.size()) < wanted)
      threads.emplace_back([&] {
        cores_of_task = cores / wanted;
        take([] {});
        const std::lock_guard lock(mutex);
        ++ended_threads;
        ended.notify_one();
      });
  } catch (const std::exception&) {  // the system has no more threads
    if (threads.empty()) take(report_mean);
  }
  std::unique_lock lock(mutex);
  while (!ended.wait_for(lock, std::chrono::milliseconds(20), [&] { return ended_threads == int(threads.size()); })) {
    lock.unlock();
    report_mean();
    lock.lock();
  }
  lock.unlock();
  for (std::thread& thread : threads) thread.join();
  if (canceled) std::rethrow_exception(canceled);
  for (const std::exception_ptr& error : errors)
    if (error) std::rethrow_exception(error);
}

/// Calls work(i) for i = 0..count-1, for loops that take about a millisecond. The calling thread does the work, and
/// sleeping threads join it if they wake in time. Nothing is reported, and work must not throw.
void parallel_for(int count, const std::function<void(int)>& work);

/// Calls work(first, end) for parts of 0..count-1, as `parallel_for` does. For items that are quickly done.
void parallel_parts(Eigen::Index count, const std::function<void(Eigen::Index, Eigen::Index)>& work);

}  // namespace dynamorph
