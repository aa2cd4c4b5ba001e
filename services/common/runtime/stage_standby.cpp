// Decides which of several instances of a stage is active: tokens, standing by, hand-over, being
// overtaken (docs/protocol.md, sections 6 and 15).

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>

#include "common/runtime/log.hpp"
#include "common/runtime/progress_watch.hpp"
#include "common/runtime/recall.hpp"
#include "common/runtime/stage_core.hpp"
#include "common/runtime/stage_list.hpp"
#include "common/runtime/whole_number.hpp"

namespace zloam::runtime {
namespace {

constexpr std::int64_t kStandByLook_ns = 20 * kMs;
constexpr std::int64_t kStandByStatus_ns = 1000 * kMs;
// Maximum waits at the start: for a link to any stage, then for the link to an older instance;
// kKnownElderWait replaces both where an older instance is known to be there.
constexpr std::chrono::milliseconds kLinkWait{200}, kElderWait{50}, kKnownElderWait{3000};
constexpr std::chrono::milliseconds kHandOver{3000};
// Zenoh's own answer for one that is there and has not answered by then.
constexpr std::string_view kTimeout = "Timeout";
// Payload of a request to take over that comes from the instance at work.
constexpr std::string_view kHandsOver = "handover";
// Statuses (one per second) after which an overtaken instance whose worker has not ended counts as
// hanging.
constexpr int kLooksAtHang = 6;

/// Why the other instance did not take over. `answer`: its refusal, or Zenoh's; empty: none came.
std::string why_not(const std::string& to, const std::string& answer) {
  if (answer.empty()) return to + " does not answer";
  if (answer != kTimeout) return to + " does not take over (" + answer + ")";
  return to + " is there and has not answered within " +
         std::to_string(std::chrono::duration_cast<std::chrono::seconds>(kHandOver).count()) +
         " s, so it hangs, or its host is overloaded; if that lasts, end its process and start it "
         "again";
}

/// The run that a driver's token names in the last chunk of its key.
std::optional<std::uint64_t> run_of(std::string_view key) {
  return whole_number<std::uint64_t>(key.substr(key.rfind('/') + 1));
}

/// A standby's watch over the active instance: subscribes to its first input, and to what it
/// publishes for each sweep.
class Listener {
 public:
  Listener(zenoh::Session& session, const Keys& keys, const StageRow& row,
           std::chrono::milliseconds longest_work)
      : watch_(std::chrono::nanoseconds(longest_work).count()) {
    const auto full = [&keys](const std::string& pattern) {
      for (const KeyRow& key : key_table()) {
        if (key.pattern == pattern) return keys.of(key.key);
      }
      throw std::logic_error("no such key: " + pattern);
    };
    input_ = session.declare_subscriber(full(row.reads.front()),
                                        [this](zenoh::Sample&&) { watch_.input(steady_ns()); });
    // A stage that acknowledges sweeps also does so for those of which it publishes nothing else
    // (mapping.every).
    const std::vector<std::string> sinks = acknowledging_stages();
    const bool acknowledges = std::find(sinks.begin(), sinks.end(), row.name) != sinks.end();
    output_ = session.declare_subscriber(
        acknowledges ? keys.flow_ack(row.name) : full(row.writes.front()),
        [this](zenoh::Sample&&) { watch_.output(); });
  }

  bool stalls(const std::optional<Seniority>& elder) {
    if (elder != elder_) watch_.begin();
    elder_ = elder;
    return elder && watch_.stalls(steady_ns());
  }

 private:
  ProgressWatch watch_;
  std::optional<Seniority> elder_;
  std::optional<zenoh::Subscriber> input_, output_;
};

}  // namespace

void StageCore::watch_tokens() {
  const Identity& id = setup_.identity;
  if (const auto place = stage_place(id.stage); place && !stage_list()[*place].replicas) {
    singleton_.emplace(session_, keys_, id.stage, Seniority{1, started_ns_, id.instance}, muted_);
    const std::vector<std::string> behind = stages_behind_the_source();
    replaceable_ = std::find(behind.begin(), behind.end(), id.stage) != behind.end();
    declare_takeover();
  }
  // The inputs of a driver belong to no driver's run.
  if (id.stage == "driver") return;
  drivers_ =
      session_.declare_liveliness_subscriber(keys_.run("*", "*"), [this](zenoh::Sample&& sample) {
        const bool there = sample.kind == zenoh::SampleKind::kPut;
        if (const auto run = run_of(sample.key)) gate_.token(sample.key, *run, there);
      });
}

// Also while this instance works: a stranger's token can silence it, and then only this request
// gives it its place back before that token goes.
void StageCore::declare_takeover() {
  const Identity& id = setup_.identity;
  takeover_.emplace(
      session_.declare_queryable(keys_.takeover(id.stage, id.instance),
                                 [request = takeover_request_, bell = bell_](zenoh::Query&& query) {
                                   request->set(std::move(query));
                                   bell->notify();
                                 }));
}

/// The request of a stage that works.
void StageCore::answer_takeover() {
  std::optional<zenoh::Query> query = takeover_request_->take();
  if (!query) return;
  const auto refuse = [&query](std::string_view why) {
    query->reply_error(zenoh::Bytes::copy_of(why));
  };
  if (leaving_) return refuse("this instance is handing over");
  if (!*muted_) return refuse("this instance works already");
  // Its state is that of the sweeps before it was silenced, and the other's goes on.
  if (query->payload().to_string() == kHandsOver) return refuse("this instance does not stand by");
  take_over("an operator asked for it", &*query);
}

void StageCore::take_over(const char* why, zenoh::Query* query) {
  singleton_->take_over();
  log_info("taking over", {{"why", why}, {"term", singleton_->term()}});
  if (query == nullptr) return;
  query->reply(keys_.takeover(setup_.identity.stage, setup_.identity.instance),
               zenoh::Bytes::copy_of(std::to_string(singleton_->term())));
}

bool StageCore::has_elder() {
  const auto wait = [this](std::chrono::milliseconds at_most) {
    return setup_.was_overtaken ? kKnownElderWait : at_most;
  };
  // Links come up in the background; an instance that sees no stage may be the first one.
  const auto linked = [this] {
    return stopping_.load() || !session_.liveliness_get(keys_.alive("*", "*"), kLinkWait).empty();
  };
  const auto found = [this] {
    singleton_->ask();
    return stopping_.load() || muted_->load();
  };
  const bool is_linked = wait_for_links(linked, wait(kLinkWait));
  if (is_linked) wait_for_links(found, wait(kElderWait));
  singleton_->enter();
  // Another may have entered at the same time.
  return is_linked && wait_for_links(found, kElderWait);
}

bool StageCore::stand_by() {
  if (!singleton_ || !has_elder()) return true;
  declare_status();
  const bool meant = setup_.shared.recovery.standby || setup_.was_overtaken;
  if (meant) {
    log_info(std::string(kStandingBy));
  } else {
    log_warning("standing by", {{"reason", singleton_->others()}});
  }
  wait_for_turn();
  // These queryables read members that are about to be wired.
  queryables_.clear();
  status_publisher_.reset();
  ready(true, "");
  return !stopping_.load();
}

void StageCore::wait_for_turn() {
  const bool meant = setup_.shared.recovery.standby || setup_.was_overtaken;
  std::optional<Listener> listener;
  if (replaceable_) {
    const StageRow& row = stage_list()[*stage_place(setup_.identity.stage)];
    listener.emplace(session_, keys_, row, setup_.longest_work);
  }
  std::int64_t told_ns = 0;
  const char* why = "the other instance has gone";
  std::optional<zenoh::Query> query;
  while (!stopping_.load()) {
    const auto elder = singleton_->elder();
    if (!elder) break;
    if (listener && listener->stalls(elder)) {
      why = "the other instance does nothing with what comes";
      break;
    }
    if (query = takeover_request_->take(); query) {
      why = "the other instance hands over, or an operator asked for it";
      break;
    }
    if (steady_ns() - told_ns >= kStandByStatus_ns) {
      ready(false, meant ? std::string(kStandingBy) : singleton_->others());
      publish_status();
      told_ns = steady_ns();
    }
    bell_->wait_until(steady_ns() + kStandByLook_ns);
  }
  if (stopping_.load()) return;
  took_over_ = replaceable_;
  take_over(why, query ? &*query : nullptr);
}

void StageCore::note_term(std::uint32_t term) {
  if (!singleton_ || term <= singleton_->term()) return;
  if (is_plausible_term(term, singleton_->term())) singleton_->at_least(term);
}

void StageCore::declare_handover() {
  if (!replaceable_) return;
  command("handover", [this](const std::string& arguments) { return hand_over(arguments); });
}

// Runs on the worker between two sweeps, when everything that only this instance knew has been
// published: the successor requests it, as after a kill.
CommandReply StageCore::hand_over(const std::string& arguments_json) {
  const auto arguments = nlohmann::json::parse(arguments_json);
  const std::string stage = setup_.identity.stage;
  const std::vector<std::string> waiting = singleton_->juniors();
  if (waiting.empty()) {
    return {false, "no other instance of " + stage +
                       " stands by: start one (zloam run --standby, recovery.standby)"};
  }
  std::string to = waiting.front();
  if (arguments.contains("to")) {
    if (!arguments["to"].is_string()) return {false, "to: the name of an instance is expected"};
    to = arguments["to"].get<std::string>();
  }
  if (std::find(waiting.begin(), waiting.end(), to) == waiting.end()) {
    std::string names;
    for (const std::string& name : waiting) names += (names.empty() ? "" : ", ") + name;
    return {false, "no instance " + to + " of " + stage + " stands by; these do: " + names};
  }
  leaving_ = true;
  singleton_->hold(true);
  for (const auto& task : on_hand_over_) task(true);
  zenoh::GetOptions options;
  options.timeout = kHandOver;
  options.payload = zenoh::Bytes::copy_of(kHandsOver);
  std::string why;
  for (const zenoh::Reply& reply : session_.get(keys_.takeover(stage, to), options)) {
    if (!reply.ok()) {
      why = reply.error.to_string();
      continue;
    }
    overtaken_ = true;
    handed_over_ns_ = steady_ns();
    for (const auto& outlet : outlets_) outlet->answer_in_silence();
    const StatusFields now = status();
    return {true, to + " goes on after sweep " +
                      (now.has_sweep ? std::to_string(now.last_sweep) : std::string("none")) +
                      ", term " + reply.sample->payload.to_string()};
  }
  singleton_->hold(false);
  leaving_ = false;
  for (const auto& task : on_hand_over_) task(false);
  return {false, why_not(to, why) + ": this instance goes on"};
}

/// Another instance has this one's work, also where the worker does not know it yet.
bool StageCore::is_overtaken() const {
  return overtaken_ || (replaceable_ && singleton_->overtaken());
}

/// Restarts an overtaken instance whose worker hangs. One that was told to stop has a deadline.
void StageCore::watch_overtaken() {
  const bool is_over = is_overtaken();
  looks_overtaken_ = is_over ? looks_overtaken_ + 1 : 0;
  if (!is_over) return;
  notify();
  if (looks_overtaken_ < kLooksAtHang || !setup_.start_again || stopping_.load()) return;
  log_error("another instance has taken over, and the worker hangs: beginning again");
  setup_.start_again();
}

}  // namespace zloam::runtime
