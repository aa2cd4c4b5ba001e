#include "common/runtime/recall.hpp"

#include <algorithm>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

#include "common/runtime/async_get.hpp"
#include "common/runtime/log.hpp"
#include "common/zenoh/aligned.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kTimeout{2000};
constexpr std::chrono::milliseconds kBetween{200};
// Requests that are repeated because only a part of the answers came.
constexpr int kMostParts = 2;
constexpr std::chrono::milliseconds kLook{20};
// The first sweep after a gap may begin before the last pose's instant.
constexpr std::int64_t kOverlap_ns = 200 * kMs;

template <class Messages>
void note_epochs(const Messages& messages, std::optional<std::uint32_t>& greatest) {
  for (const auto& message : messages) {
    greatest = std::max(greatest.value_or(0), message.header().odom_epoch());
  }
}

}  // namespace

bool wait_for_links(const std::function<bool()>& there, std::chrono::milliseconds at_most) {
  const auto until = std::chrono::steady_clock::now() + at_most;
  while (!there()) {
    if (std::chrono::steady_clock::now() >= until) return false;
    std::this_thread::sleep_for(kLook);
  }
  return true;
}

bool is_there(Stage& stage, std::string_view other_stage) {
  // A stage declares its token last, so its queryables are there when the token is.
  return !stage.session().liveliness_get(stage.keys().alive(other_stage, "*"), kTimeout).empty();
}

std::string sweeps_from(std::uint64_t run, std::uint64_t first, std::uint64_t last) {
  return "run=" + std::to_string(run) + ";sweep=" + std::to_string(first) + ".." +
         std::to_string(last);
}

namespace {

/// Nothing if it can't be read: torn on its way, or not what the key holds.
std::optional<Message> read(Stage& stage, zenoh::Sample sample, VerifyFunction verify,
                            HeaderFunction header) {
  Message message;
  const zenoh::AlignedBytes bytes = zenoh::view_aligned(std::move(sample.payload));
  if (!verify(bytes.data(), sample.encoding).ok()) return std::nullopt;
  message.owner = std::make_shared<const zenoh::AlignedBytes>(bytes);
  message.bytes = bytes.data();
  message.header = header(message.bytes);
  message.received_ns = message.started_ns = stage.now_ns();
  message.recovered = true;
  stage.note_term(message.header->term());
  return message;
}

void report_part(Stage& stage, const std::string& selector, const std::string& why) {
  const std::string text = "not all of " + selector + " came (" + why +
                           "): the map that was restored may lack parts; see the store, and start "
                           "this stage again";
  log_warning(text);
  stage.degraded("recall", text);
}

}  // namespace

std::vector<Message> recall_messages(Stage& stage, const std::string& selector,
                                     VerifyFunction verify, HeaderFunction header, int tries,
                                     const RecallFrom& from) {
  const std::chrono::nanoseconds quiet = stage.overtook() ? from.quiet : from.longest_pause;
  std::vector<Message> best;
  std::string lacks;
  int parts = 0, late = 0;
  for (int i = 0; i < tries && !stage.stopping(); ++i) {
    if (i > 0 || late > 0) std::this_thread::sleep_for(kBetween);
    Answers answers = get_and_wait(stage.session(), selector, from.timeout, quiet, kTimeout);
    std::vector<Message> found;
    std::string why = answers.error;
    // One that was overtaken because it hangs never ends its answer.
    if (why.empty() && !answers.ended && !stage.overtook()) why = "the answers broke off";
    for (zenoh::Sample& sample : answers.samples) {
      if (auto message = read(stage, std::move(sample), verify, header)) {
        found.push_back(std::move(*message));
      } else {
        why = "some answers can't be read";
      }
    }
    if (found.empty() && best.empty()) {
      const bool is_late = !answers.ended || !answers.error.empty();
      if (is_late && !stage.overtook() && late++ < from.late_tries) --i;
      continue;
    }
    const bool whole = why.empty() && !found.empty();
    if (whole || found.size() > best.size()) {
      best = std::move(found);
      lacks = why;
    }
    if (whole || !from.must_be_whole || ++parts > kMostParts) break;
  }
  if (!lacks.empty() && from.must_be_whole) report_part(stage, selector, lacks);
  return best;
}

void sort_by_sweep(std::vector<Message>& messages) {
  const auto identity = [](const Message& m) {
    return std::pair(m.header->run(), m.header->sweep());
  };
  std::stable_sort(messages.begin(), messages.end(),
                   [&](const Message& a, const Message& b) { return identity(a) < identity(b); });
  const auto same = [&](const Message& a, const Message& b) { return identity(a) == identity(b); };
  messages.erase(std::unique(messages.begin(), messages.end(), same), messages.end());
}

bool goes_on(const msg::Header& first, std::int64_t instant_ns, std::int64_t longest_ns) {
  const std::int64_t gap_ns = first.stamp_ns() - instant_ns;
  return !first.replay() && gap_ns > -kOverlap_ns && gap_ns < longest_ns;
}

std::optional<std::uint32_t> used_odom_epoch(
    Stage& stage, std::span<const Received<msg::OdometryFeatures>> commits) {
  std::optional<std::uint32_t> used;
  note_epochs(commits, used);
  note_epochs(recall<msg::Odometry>(stage, Key::kOdometry, kKept, 1), used);
  note_epochs(recall<msg::MapPose>(stage, Key::kMapOdometry, {}, 1), used);
  return used;
}

bool Gap::add(std::uint64_t from, std::uint64_t until) {
  if (until <= from) return false;
  if (empty()) first = from;
  last = until - 1;
  return true;
}

void report(Stage& stage, const Gap& gap) {
  const double gap_ms = 1e-6 * static_cast<double>(gap.ns);
  const bool any = !gap.empty();
  log_warning("went on after a gap", {{"first_sweep", any ? std::to_string(gap.first) : "none"},
                                      {"last_sweep", any ? std::to_string(gap.last) : "none"},
                                      {"ns", gap.ns}});
  stage.figure("gap_sweeps", any ? static_cast<double>(gap.last - gap.first + 1) : 0.0);
  stage.figure("gap_first_sweep", any ? static_cast<double>(gap.first) : -1.0);
  stage.figure("gap_last_sweep", any ? static_cast<double>(gap.last) : -1.0);
  stage.figure("gap_ms", gap_ms);
}

}  // namespace zloam::runtime
