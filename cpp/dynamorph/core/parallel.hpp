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
/// caller's `progress` hears the mean and is called from the calling thread alone. Rethrows what a work threw.
template <class Work>
void run_tasks(int count, const ProgressFn& progress, const Work& work) {
  std::vector<std::atomic<double>> done(count);
  std::vector<std::exception_ptr> errors(count);
  std::atomic<int> next{0};
  std::atomic<bool> stop{false};
  std::mutex mutex;
  std::condition_variable ended;
  int running = std::clamp(usable_cores(), 1, std::max(count, 1));
  std::vector<std::thread> threads;
  for (int t = running; t > 0; --t)
    threads.emplace_back([&] {
      for (int i; (i = next++) < count && !stop;) try {
          work(i, [&done, &stop, i](double fraction) {
            done[i] = fraction;
            return !stop;
          });
        } catch (const Cancelled&) {  // told to stop: the caller's wish or another's error is the reason
          stop = true;
        } catch (...) {
          errors[i] = std::current_exception();
          stop = true;
        }
      const std::lock_guard lock(mutex);
      --running;
      ended.notify_one();
    });
  std::exception_ptr cancelled;
  std::unique_lock lock(mutex);
  while (!ended.wait_for(lock, std::chrono::milliseconds(20), [&] { return running == 0; })) {
    lock.unlock();
    try {
      if (!cancelled) report(progress, std::accumulate(done.begin(), done.end(), 0.0) / count);
    } catch (...) {
      cancelled = std::current_exception();
      stop = true;
    }
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
