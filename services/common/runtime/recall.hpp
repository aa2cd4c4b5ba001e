#pragma once
// Recovers state in the middle of a run: what other processes keep of a killed instance, and what
// its inputs' publishers still have. A restarted stage asks for it when a run begins
// (docs/protocol.md, section 7).

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/runtime/stage.hpp"

namespace zloam::runtime {

/// Parameters of a selector: all messages that readers of the key keep (InletOptions::keep).
inline constexpr std::string_view kKept = "kept=1";
/// Default of `last`: to the end.
std::string sweeps_from(std::uint64_t run, std::uint64_t first,
                        std::uint64_t last = std::uint64_t{1} << 62);

/// Limit of constant-motion prediction at a car's speed: after 1.9 s at 6 m/s it was metres off.
inline constexpr std::int64_t kLongestGap_ns = 1'000'000'000;
/// Up to this gap the pose in the map is still searched for near the predicted motion; a container
/// takes a second or two to restart.
inline constexpr std::int64_t kLongestSearch_ns = 3'000'000'000;

/// Whether the newest run continues in this one, which a restarted driver began: the gap between
/// them is shorter than `longest_ns`. `instant_ns`: of the last pose before.
bool goes_on(const msg::Header& first, std::int64_t instant_ns,
             std::int64_t longest_ns = kLongestGap_ns);

/// Waits (worker only) for the links to the processes that may keep something: then one
/// request is enough, and if nothing is kept nothing is lost. False: the links did not come up
/// in time.
bool wait_for_links(const std::function<bool()>& there, std::chrono::milliseconds at_most);
/// Whether an instance of the stage can be asked now.
bool is_there(Stage& stage, std::string_view other_stage);

/// Sweeps that this stage missed while it was away, as figures of its status and in the log.
struct Gap {
  /// sweeps of this run; last < first: none
  std::uint64_t first = 1, last = 0;
  std::int64_t ns = 0;

  bool empty() const { return last < first; }
  /// Adds the sweeps from `from` up to the one before `until`; false: there are none.
  bool add(std::uint64_t from, std::uint64_t until);
};
void report(Stage& stage, const Gap& gap);

/// Asks and waits (worker only). Invalid messages are ignored. A link that is not yet up looks like
/// no answer: up to `tries` requests, 200 ms apart, before nothing is accepted as the answer.
/// `quiet`: once some answers have come, wait this long for more if an overtaken instance is still
/// there: it may hang and never end its answer.
struct RecallFrom {
  std::chrono::milliseconds timeout, quiet;
  /// Between two answers of one that is not known to hang.
  std::chrono::nanoseconds longest_pause;
  /// Answers that are missing or unreadable make the stage `degraded`: nothing else tells of them.
  bool must_be_whole;
  /// Further requests while somebody who is there has not answered in time, as a store that is
  /// writing: that is not the answer that there is nothing.
  int late_tries = 0;
};
std::vector<Message> recall_messages(Stage& stage, const std::string& selector,
                                     VerifyFunction verify, HeaderFunction header, int tries,
                                     const RecallFrom& from);
/// Messages that a stage keeps, which arrive at once; the gap in their numbers tells what is missing.
inline constexpr RecallFrom kMemory{.timeout = std::chrono::milliseconds(2000),
                                    .quiet = std::chrono::milliseconds(300),
                                    .longest_pause = std::chrono::seconds(2),
                                    .must_be_whole = false};
/// The newest message of a key, which a store may have.
inline constexpr RecallFrom kStore{.timeout = std::chrono::milliseconds(2000),
                                   .quiet = std::chrono::milliseconds(300),
                                   .longest_pause = std::chrono::seconds(2),
                                   .must_be_whole = false,
                                   .late_tries = 10};
/// A map, which may come from a disk.
inline constexpr RecallFrom kDisk{.timeout = std::chrono::milliseconds(20000),
                                  .quiet = std::chrono::milliseconds(1500),
                                  .longest_pause = std::chrono::seconds(5),
                                  .must_be_whole = true};

/// Each (run, sweep) once, ascending.
void sort_by_sweep(std::vector<Message>& messages);

template <class T>
std::vector<Received<T>> recall_from(Stage& stage, const std::string& selector, int tries,
                                     bool by_sweep, const RecallFrom& from) {
  std::vector<Message> messages = recall_messages(
      stage, selector, &verify<T>,
      [](std::span<const std::uint8_t> bytes) { return message_of<T>(bytes).header(); }, tries,
      from);
  if (by_sweep) sort_by_sweep(messages);
  std::vector<Received<T>> found;
  found.reserve(messages.size());
  for (Message& m : messages) found.emplace_back(std::move(m));
  return found;
}

template <class T>
std::vector<Received<T>> recall_at(Stage& stage, const std::string& selector, int tries,
                                   bool by_sweep) {
  return recall_from<T>(stage, selector, tries, by_sweep, by_sweep ? kMemory : kDisk);
}

template <class T>
std::vector<Received<T>> recall(Stage& stage, Key key, std::string_view parameters, int tries) {
  const std::string key_of = stage.keys().of(key);
  return recall_at<T>(stage, parameters.empty() ? key_of : key_of + "?" + std::string(parameters),
                      tries, true);
}

/// Greatest epoch of an odom frame in `commits` and in the poses that other stages keep. A frame
/// must not have it again: mapping would apply the correction of the old frame to it.
std::optional<std::uint32_t> used_odom_epoch(
    Stage& stage, std::span<const Received<msg::OdometryFeatures>> commits);

}  // namespace zloam::runtime
