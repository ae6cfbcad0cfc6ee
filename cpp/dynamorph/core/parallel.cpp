// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/core/parallel.hpp"

#ifdef __linux__
#include <sched.h>
#endif

namespace dynamorph {

namespace {

/// Threads that sleep between loops. Starting new threads takes longer. On a busy machine the caller would also have to
/// wait until all of them have started, even after it has done their work itself.
class Helpers {
 public:
  /// Calls work(0) .. work(count - 1) on the calling thread and at most `limit` helpers.
  void run(int count, int limit, const std::function<void(int)>& work) {
    std::unique_lock lock(mutex_);
    if (work_) {  // the helpers work for another thread
      lock.unlock();
      for (int i = 0; i < count; ++i) work(i);
      return;
    }
    try {
      for (; threads_ < limit; ++threads_) std::thread([this] { help(); }).detach();
    } catch (const std::exception&) {  // the system has no more threads; the next loop tries again
    }
    work_ = &work;
    count_ = count;
    next_ = 0;
    wanted_ = limit;
    ++loop_;
    lock.unlock();
    begun_.notify_all();
    take(work);
    lock.lock();
    ended_.wait(lock, [&] { return busy_ == 0; });
    work_ = nullptr;
  }

 private:
  void take(const std::function<void(int)>& work) {
    for (int i; (i = next_++) < count_;) work(i);
  }

  void help() {
    std::unique_lock lock(mutex_);
    for (long last = 0;; last = loop_) {
      begun_.wait(lock, [&] { return work_ && loop_ != last && wanted_ > 0; });
      --wanted_;
      ++busy_;
      const std::function<void(int)>& work = *work_;
      lock.unlock();
      take(work);
      lock.lock();
      if (--busy_ == 0) ended_.notify_one();
    }
  }

  std::mutex mutex_;
  std::condition_variable begun_, ended_;
  const std::function<void(int)>* work_ = nullptr;  ///< of the current loop
  int count_ = 0, busy_ = 0, wanted_ = 0, threads_ = 0;
  long loop_ = 0;
  std::atomic<int> next_{0};
};

std::atomic<int> thread_limit{0};  ///< the limit set by the user; 0 for none

int allowed_cores() {
#ifdef __linux__  // hardware_concurrency counts all cores of the machine
  cpu_set_t allowed;
  if (sched_getaffinity(0, sizeof allowed, &allowed) == 0) return CPU_COUNT(&allowed);
#endif
  return int(std::thread::hardware_concurrency());
}

}  // namespace

int usable_cores() {
  if (cores_of_task > 0) return cores_of_task;
  const int limit = thread_limit, cores = std::max(1, allowed_cores());
  return limit > 0 ? std::min(limit, cores) : cores;
}

void set_threads(int limit) {
  if (limit < 0)
    throw std::invalid_argument("threads: expected 0, for all cores, or more, got " + std::to_string(limit));
  thread_limit = limit;
}

void parallel_for(int count, const std::function<void(int)>& work) {
  // Never destroyed: the process may exit while the threads sleep, and the threads must not outlive what they wait on.
  static Helpers& helpers = *new Helpers;
  helpers.run(count, usable_cores() - 1, work);
}

void parallel_parts(Eigen::Index count, const std::function<void(Eigen::Index, Eigen::Index)>& work) {
  constexpr Eigen::Index kPart = 256;
  parallel_for(int((count + kPart - 1) / kPart),
               [&](int part) { work(part * kPart, std::min(count, (part + 1) * kPart)); });
}

}  // namespace dynamorph
