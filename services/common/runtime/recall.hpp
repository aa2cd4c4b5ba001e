#pragma once
// What others keep of an instance that was killed, and what its inputs' publishers still have:
// asked for when a run begins, by a stage that was started in the middle of it (docs/protocol.md,
// section 7).

#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "common/runtime/stage.hpp"

namespace zloam::runtime {

/// Of a selector's parameters: all that is kept by readers of the key (InletOptions::keep).
inline constexpr std::string_view kKept = "kept=1";
/// `last` of default: to the end.
std::string sweeps_from(std::uint64_t run, std::uint64_t first,
                        std::uint64_t last = std::uint64_t{1} << 62);

/// At a car's speed a constant motion tells no more: after 1.9 s at 6 m/s the pose was metres off.
inline constexpr std::int64_t kLongestGap_ns = 1'000'000'000;
/// So long after it is the place in the map still searched for near where the motion leads; a
/// container that is started again takes a second or two.
inline constexpr std::int64_t kLongestSearch_ns = 3'000'000'000;

/// The newest run goes on in this one, which the driver began anew: the sensor was not away for
/// longer than its motion can be told over, or `longest_ns`. `instant_ns`: of the last pose before.
bool goes_on(const msg::Header& first, std::int64_t instant_ns,
             std::int64_t longest_ns = kLongestGap_ns);

/// Waits, for the worker only, until the links are there over which a question reaches whoever may
/// keep something: then one asking is enough, and where nothing is kept nothing is lost. False:
/// they did not come.
bool wait_for_links(const std::function<bool()>& there, std::chrono::milliseconds at_most);
/// Whether an instance of the stage can be asked now.
bool is_there(Stage& stage, std::string_view other_stage);

/// What this stage did not do while it was away, as figures of its status and in the log.
struct Gap {
  /// sweeps of this run; last < first: none
  std::uint64_t first = 1, last = 0;
  std::int64_t ns = 0;

  bool empty() const { return last < first; }
  /// Sweeps from one on, up to the one before another; false: there are none between them.
  bool add(std::uint64_t from, std::uint64_t until);
};
void report(Stage& stage, const Gap& gap);

/// Asks and waits, for the worker only. What is no message in order is left out. A link that is not
/// yet up looks like nobody who answers: `tries` askings, 200 ms apart, before nothing is taken for
/// an answer. `quiet`: so long after some have come no more are waited for, where an instance that
/// was overtaken is still there: it may hang, and say not even that it has nothing.
std::vector<Message> recall_messages(Stage& stage, const std::string& selector,
                                     VerifyFunction verify, HeaderFunction header, int tries,
                                     std::chrono::milliseconds quiet);
/// Of messages from memory, which come at once.
inline constexpr std::chrono::milliseconds kQuietMemory{300};
/// Of what may come from a disk.
inline constexpr std::chrono::milliseconds kQuietDisk{1500};

/// Each (run, sweep) once, ascending.
void sort_by_sweep(std::vector<Message>& messages);

template <class T>
std::vector<Received<T>> recall_at(Stage& stage, const std::string& selector, int tries,
                                   bool by_sweep) {
  std::vector<Message> messages = recall_messages(
      stage, selector, &verify<T>,
      [](std::span<const std::uint8_t> bytes) { return message_of<T>(bytes).header(); }, tries,
      by_sweep ? kQuietMemory : kQuietDisk);
  if (by_sweep) sort_by_sweep(messages);
  std::vector<Received<T>> found;
  found.reserve(messages.size());
  for (Message& m : messages) found.emplace_back(std::move(m));
  return found;
}

template <class T>
std::vector<Received<T>> recall(Stage& stage, Key key, std::string_view parameters, int tries) {
  const std::string key_of = stage.keys().of(key);
  return recall_at<T>(stage, parameters.empty() ? key_of : key_of + "?" + std::string(parameters),
                      tries, true);
}

}  // namespace zloam::runtime
