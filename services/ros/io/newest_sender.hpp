#pragma once
// Sends messages of which only the newest counts, however slow the way to their readers is.

#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "common/zenoh/zenoh.hpp"

namespace zloam::ros {

class NewestSender {
 public:
  /// payload, attachment
  using Message = std::pair<zenoh::Bytes, zenoh::Bytes>;

  /// send() runs on a thread of its own and may take long. unblock() makes a running send(), and
  /// those after it, return; it is called at the end, if the last message is not sent within a
  /// second.
  NewestSender(std::function<void(const Message&)> send, std::function<void()> unblock);
  ~NewestSender();
  NewestSender(const NewestSender&) = delete;
  NewestSender& operator=(const NewestSender&) = delete;

  /// Returns at once. A message that still waits is replaced.
  void send(Message message);

 private:
  void run();

  std::function<void(const Message&)> send_;
  std::function<void()> unblock_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<Message> waiting_;
  bool ends_ = false, ended_ = false;
  std::thread thread_;
};

}  // namespace zloam::ros
