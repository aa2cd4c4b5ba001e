#include "common/runtime/live_config.hpp"

#include <algorithm>
#include <charconv>
#include <iterator>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/runtime/config.hpp"
#include "common/runtime/json_guard.hpp"
#include "common/runtime/log.hpp"
#include "common/runtime/query_guard.hpp"
#include "common/zenoh/aligned.hpp"

namespace zloam::runtime {
namespace {

constexpr const char* kVerb = "set";
constexpr const char* kPresetBy = "command line";
// Answers come at once or never: a peer that hangs must not delay the sweeps.
constexpr std::chrono::milliseconds kTimeout{500};
// How long the answer to a change waits for another process to keep it too.
constexpr std::int64_t kKeptWithin_ns = 1000 * kMs;
// After the last answer so far, wait only this long for more: a process that hangs must not delay
// the answer to a change.
constexpr std::chrono::milliseconds kQuiet{20};
constexpr std::int64_t kRemindEvery_ns = 200 * kMs;
// Minimum time between queries, however often puts announce a new revision.
constexpr std::int64_t kAskEvery_ns = 10 * kMs;
// Maximum of revisions per stage, more than a person makes by hand.
constexpr std::size_t kMostRevisions = 4096;

zenoh::PublisherOptions publisher_options() {
  zenoh::PublisherOptions o;
  o.priority = zenoh::Priority::kDataHigh;
  o.encoding = encoding_of(Key::kConfigRevision);
  return o;
}

std::optional<Revision> read(const zenoh::Sample& sample) {
  if (!fits(Key::kConfigRevision, sample.payload.size())) return std::nullopt;
  const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
  if (!verify<msg::ConfigRevision>(bytes.data(), sample.encoding).ok()) return std::nullopt;
  const msg::ConfigRevision& m = message_of<msg::ConfigRevision>(bytes.data());
  if (!json_error(m.values_json()->string_view()).empty()) return std::nullopt;
  return Revision{m.stage()->str(),       m.rev(),       m.run(),  m.from_sweep(),
                  m.values_json()->str(), m.by()->str(), m.at_ns()};
}

/// The stage in a token's key ".../service/<stage>/<instance>/alive".
std::string stage_of_token(const std::string& key) {
  const std::string rest = key.substr(0, key.rfind('/', key.rfind('/') - 1));
  return rest.substr(rest.rfind('/') + 1);
}

std::string merged(const std::string& values_json, const std::string& changed_json) {
  nlohmann::json values = nlohmann::json::parse(values_json);
  values.update(nlohmann::json::parse(changed_json));
  return values.dump();
}

/// "30:key=value" as (30, "key=value").
std::pair<std::uint64_t, std::string> preset(const std::string& text) {
  std::uint64_t sweep = 0;
  const auto colon = std::min(text.find(':'), text.size());
  const auto [end, error] = std::from_chars(text.data(), text.data() + colon, sweep);
  if (error != std::errc{} || end != text.data() + colon || colon == text.size()) {
    throw ConfigError("--set-at " + text +
                      ": SWEEP:key=value is expected, such as 30:odometry.x=1");
  }
  return {sweep, text.substr(colon + 1)};
}

/// The settings in a Command message or in bare text: a JSON object, or lines "key=value".
std::vector<std::string> settings_of(const zenoh::Query& query) {
  std::string text = query.payload().to_string();
  const zenoh::AlignedBytes bytes = zenoh::view_aligned(query.payload());
  if (verify<msg::Command>(bytes.data(), encoding_of(Key::kCommand)).ok()) {
    const auto* arguments = message_of<msg::Command>(bytes.data()).arguments_json();
    text = arguments == nullptr ? "" : arguments->str();
  }
  if (const std::string error = json_error(text); !error.empty()) throw ConfigError(error);
  std::vector<std::string> settings;
  const nlohmann::json object = nlohmann::json::parse(text, nullptr, false);
  if (object.is_object()) {
    for (const auto& [key, value] : object.items()) {
      settings.push_back(key + "=" + (value.is_string() ? value.get<std::string>() : value.dump()));
    }
    return settings;
  }
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (!line.empty()) settings.push_back(line);
  }
  return settings;
}

}  // namespace

LiveConfig::LiveConfig(LiveConfigSetup setup, EffectiveValues at_start, const Keys& keys,
                       zenoh::Session& session, std::shared_ptr<Shared> bell,
                       std::function<bool(std::function<void()>)> offer)
    : setup_(std::move(setup)),
      keys_(keys),
      session_(session),
      bell_(std::move(bell)),
      offer_(std::move(offer)),
      effective_(std::move(at_start)) {
  for (const StageRow& row : stage_list()) schedules_[row.name];
  schedules_[setup_.identity.stage];
  if (setup_.parameters != nullptr) base_json_ = setup_.parameters->live_values_json();
  for (const Revision& preset : setup_.presets) {
    schedules_[preset.stage].add(preset);
    keep(preset);
    presets_text_ += std::to_string(preset.from_sweep) + ":" + preset.values_json;
  }
  declare();
  refresh();
}

void LiveConfig::declare() {
  const std::string all = keys_.config_revision("*");
  queryables_.push_back(session_.declare_queryable(
      all,
      [this](zenoh::Query&& query) {
        const std::lock_guard lock(mutex_);
        for (const auto& [name, message] : kept_) {
          query.reply(keys_.config_revision(name.first), message,
                      encoding_of(Key::kConfigRevision));
        }
      },
      false));
  subscriber_ = session_.declare_subscriber(all, [this](zenoh::Sample&& sample) {
    if (sample.kind != zenoh::SampleKind::kPut) return;
    hinted_ = true;
    bell_->notify();
  });
  tokens_ =
      session_.declare_liveliness_subscriber(keys_.alive("*", "*"), [this](zenoh::Sample&& sample) {
        const bool there = sample.kind == zenoh::SampleKind::kPut;
        // Ask for the changes that were made while there was no link to this instance.
        if (there) hinted_ = true;
        offer_([this, key = sample.key, there] { hear_token(key, there); });
      });
  if (setup_.parameters == nullptr) return;
  queryables_.push_back(session_.declare_queryable(
      keys_.command(setup_.identity.stage, kVerb), [this](zenoh::Query&& query) {
        if (*setup_.muted || refused_for_size(query)) return;
        const auto shared = std::make_shared<zenoh::Query>(std::move(query));
        if (offer_([this, shared] { answer_set(shared); })) return;
        refuse_as_busy(*shared, keys_.command(setup_.identity.stage, kVerb));
      }));
}

void LiveConfig::hear_token(const std::string& key, bool there) {
  if (there) {
    lives_.came(key, steady_ns());
    return;
  }
  const auto found = schedules_.find(stage_of_token(key));
  if (found == schedules_.end()) return;
  const Revision* newest = found->second.newest();
  const std::uint32_t rev = newest == nullptr ? 0 : newest->rev;
  if (lives_.went(key, found->first, rev, steady_ns())) withdraw(found->first, rev);
}

void LiveConfig::withdraw(const std::string& stage, std::uint32_t rev) {
  log_error("a stage has ended again and again with a revision, which is withdrawn",
            {{"stage", stage}, {"rev", rev}});
  schedules_.find(stage)->second.withdraw(rev, steady_ns());
  {
    const std::lock_guard lock(mutex_);
    kept_.erase({stage, rev});
  }
  refresh();
}

void LiveConfig::answer_set(const std::shared_ptr<zenoh::Query>& query) {
  // Only one of several instances answers (docs/protocol.md, section 11).
  if (*setup_.muted || (mine_ && !mine_(run_))) return;
  CommandReply reply;
  try {
    reply = set(settings_of(*query));
  } catch (const std::exception& e) {
    reply = {false, kVerb + std::string(": ") + e.what()};
  }
  if (!reply.ok) return answer(*query, reply);
  unconfirmed_.push_back({query, reply, own().newest()->rev, steady_ns() + kKeptWithin_ns});
}

void LiveConfig::answer(zenoh::Query& query, const CommandReply& reply) {
  log_info("command", {{"verb", kVerb}, {"ok", reply.ok}, {"message", reply.message}});
  query.reply(keys_.command(setup_.identity.stage, kVerb), zenoh::Bytes::own(build(reply)),
              encoding_of(Key::kCommand));
}

/// Answers a change once another process keeps it too. Otherwise it would be lost unnoticed if this
/// process were killed right after its answer.
void LiveConfig::confirm() {
  if (unconfirmed_.empty()) return;
  const auto answers = confirming_.take(kQuiet);
  const std::int64_t now = steady_ns();
  std::erase_if(unconfirmed_, [&](Unconfirmed& change) {
    if (answers && keepers(*answers, change.rev) > 1) {
      answer(*change.query, change.reply);
      return true;
    }
    if (now < change.until_ns) return false;
    change.reply.message += "; no other process has it yet, and it is lost if this one ends";
    answer(*change.query, change.reply);
    return true;
  });
  if (unconfirmed_.empty() || confirming_.started() || now < next_confirm_ns_) return;
  next_confirm_ns_ = now + kAskEvery_ns;
  confirming_.start(session_, keys_.config_revision(setup_.identity.stage), kTimeout, bell_);
}

/// Number of processes that keep the revision, including this one.
std::ptrdiff_t LiveConfig::keepers(const std::vector<zenoh::Sample>& answers,
                                   std::uint32_t rev) const {
  return std::count_if(answers.begin(), answers.end(), [&](const zenoh::Sample& answer) {
    const auto revision = read(answer);
    return revision && revision->stage == setup_.identity.stage && revision->rev == rev;
  });
}

CommandReply LiveConfig::set(const std::vector<std::string>& settings) {
  if (setup_.parameters == nullptr) return {false, "set: nothing can be changed here"};
  std::string changed;
  try {
    with(own().newest(), [&] { changed = setup_.parameters->check_live(settings, kVerb); });
  } catch (const ConfigError& e) {
    return {false, e.what()};
  }
  if (!newest_seen_) {
    return {false,
            "set: no sweep has come yet, so there is none to change at; start the stage with "
            "--set, or ask again when sweeps come"};
  }
  Revision revision = next(changed);
  const Revision* newest = own().newest();
  if (newest != nullptr && newest->run == run_ && newest->values_json == revision.values_json) {
    // Another replica, which does not know of this one yet, has already made the same change.
    revision = *newest;
  } else {
    if (!accept(revision)) {
      return {false, "set: not taken, since " + std::to_string(kMostRevisions) +
                         " changes are the most that a stage remembers; start it again with --set"};
    }
    publish(revision);
  }
  const nlohmann::json results = {{"rev", revision.rev},
                                  {"run", revision.run},
                                  {"from_sweep", revision.from_sweep},
                                  {"values", nlohmann::json::parse(revision.values_json)}};
  return {true,
          "revision " + std::to_string(revision.rev) + " from sweep " +
              std::to_string(revision.from_sweep) + " on: " + changed,
          results.dump()};
}

Revision LiveConfig::next(const std::string& changed_json) const {
  const Revision* before = own().newest();
  Revision r;
  r.stage = setup_.identity.stage;
  r.rev = before == nullptr ? 1 : before->rev + 1;
  r.run = run_;
  r.from_sweep = newest_seen_.value_or(0) + 2 * static_cast<std::uint64_t>(setup_.window);
  if (before != nullptr && before->run == run_) {
    r.from_sweep = std::max(r.from_sweep, before->from_sweep);
  }
  r.values_json = merged(before == nullptr ? "{}" : before->values_json, changed_json);
  r.by = setup_.identity.instance;
  r.at_ns = wall_ns();
  return r;
}

void LiveConfig::take(const zenoh::Sample& sample) {
  if (sample.kind != zenoh::SampleKind::kPut) return;
  const auto revision = read(sample);
  if (revision && !deaf_to(*revision)) accept(*revision);
}

bool LiveConfig::deaf_to(const Revision& revision) const {
  return setup_.deaf_sweeps > 0 && revision.stage == setup_.identity.stage &&
         newest_used_.value_or(0) < revision.from_sweep + setup_.deaf_sweeps;
}

bool LiveConfig::accept(const Revision& revision) {
  const auto schedule = schedules_.find(revision.stage);
  if (schedule == schedules_.end() || schedule->second.all().size() >= kMostRevisions) return false;
  if (schedule->second.is_withdrawn(revision, steady_ns())) return false;
  const bool is_own = revision.stage == setup_.identity.stage;
  if (is_own && !usable(revision)) return false;
  if (!schedule->second.add(revision)) return false;
  keep(revision);
  log_info("a revision of the configuration", {{"stage", revision.stage},
                                               {"rev", revision.rev},
                                               {"from_sweep", revision.from_sweep},
                                               {"values", revision.values_json}});
  if (on_revision_) on_revision_(revision);
  if (!is_own) return true;
  refresh();
  const bool late = revision.run == run_ && newest_used_ && revision.from_sweep <= *newest_used_;
  if (!late) return true;
  log_warning("sweeps were worked on before their revision of the configuration was heard of",
              {{"rev", revision.rev}, {"from_sweep", revision.from_sweep}});
  if (on_late_) on_late_(revision);
  return true;
}

bool LiveConfig::usable(const Revision& revision) {
  if (setup_.parameters == nullptr) return false;
  try {
    with(&revision, [] {});
    return true;
  } catch (const ConfigError& e) {
    log_error("a revision of the configuration can't be used",
              {{"rev", revision.rev}, {"by", revision.by}, {"what", e.what()}});
    return false;
  }
}

void LiveConfig::with(const Revision* revision, const std::function<void()>& task) {
  Parameters& parameters = *setup_.parameters;
  const std::string before = parameters.live_values_json();
  try {
    apply(revision);
    task();
  } catch (...) {
    parameters.set_live(before);
    throw;
  }
  parameters.set_live(before);
}

void LiveConfig::keep(const Revision& revision) {
  const std::lock_guard lock(mutex_);
  kept_.insert_or_assign({revision.stage, revision.rev}, zenoh::Bytes::own(build(revision)));
}

void LiveConfig::publish(const Revision& revision) {
  session_.put(keys_.config_revision(revision.stage), zenoh::Bytes::own(build(revision)),
               publisher_options());
}

void LiveConfig::begin_run(std::uint64_t run) {
  for (const zenoh::Sample& sample :
       get_and_wait(session_, keys_.config_revision("*"), kTimeout).samples) {
    take(sample);
  }
  in_run_ = true;
  run_ = run;
  newest_seen_.reset();
  newest_used_.reset();
  for (auto& [stage, schedule] : schedules_) {
    schedule.begin_run(run);
    // The schedule has assigned revisions made outside runs to this run: answers must name it.
    for (const Revision& revision : schedule.all()) keep(revision);
  }
  refresh();
}

void LiveConfig::end_run() {
  in_run_ = false;
  refresh();
}

void LiveConfig::saw(std::uint64_t run, std::uint64_t sweep) {
  if (run == run_) newest_seen_ = std::max(newest_seen_.value_or(0), sweep);
}

void LiveConfig::tick() {
  confirm();
  if (hinted_.exchange(false)) to_ask_ = true;
  if (const auto answers = get_.take()) {
    for (const zenoh::Sample& sample : *answers) take(sample);
  }
  const std::int64_t now = steady_ns();
  if (!to_ask_ || get_.started() || now < next_ask_ns_) return;
  to_ask_ = false;
  next_ask_ns_ = now + kAskEvery_ns;
  get_.start(session_, keys_.config_revision("*"), kTimeout, bell_);
}

std::optional<std::int64_t> LiveConfig::deadline() const {
  if (!unconfirmed_.empty()) return steady_ns() + kAskEvery_ns;
  if (!to_ask_ || get_.started()) return std::nullopt;
  return next_ask_ns_;
}

/// Publishes the stage's newest revision again: an instance that works with another revision than
/// the one in force has missed a change.
void LiveConfig::remind(std::string_view stage) {
  const std::int64_t now = steady_ns();
  if (now - reminded_ns_ < kRemindEvery_ns) return;
  reminded_ns_ = now;
  const auto schedule = schedules_.find(stage);
  if (const Revision* newest = schedule->second.newest()) publish(*newest);
}

bool LiveConfig::agrees(std::string_view stage, const msg::Header& header) {
  const auto schedule = schedules_.find(stage);
  if (schedule == schedules_.end()) return true;
  if (header.config_rev() == schedule->second.rev_at(header.run(), header.sweep())) return true;
  const Revision* newest = schedule->second.newest();
  if (newest == nullptr || header.config_rev() > newest->rev) {
    to_ask_ = true;
  } else {
    remind(stage);
  }
  return false;
}

std::uint32_t LiveConfig::rev_at(std::uint64_t run, std::uint64_t sweep) const {
  return own().rev_at(run, sweep);
}

bool LiveConfig::configure_for(std::uint64_t run, std::uint64_t sweep) {
  saw(run, sweep);
  if (run == run_) newest_used_ = std::max(newest_used_.value_or(0), sweep);
  const Revision* revision = own().in_force(run, sweep);
  const std::uint32_t rev = revision == nullptr ? 0 : revision->rev;
  if (rev == applied_) return false;
  apply(revision);
  applied_ = rev;
  refresh();
  return true;
}

void LiveConfig::apply(const Revision* revision) {
  setup_.parameters->set_live(base_json_);
  if (revision != nullptr) setup_.parameters->set_live(revision->values_json);
}

void LiveConfig::refresh() {
  if (setup_.parameters == nullptr) return;
  EffectiveValues now{applied_, setup_.parameters->values_json(), {}};
  const Revision* first = in_run_ ? own().in_force(run_, 0) : own().newest();
  with(first, [&] { now.result_json = setup_.parameters->result_values_json() + presets_text_; });
  const std::lock_guard lock(mutex_);
  effective_ = std::move(now);
}

EffectiveValues LiveConfig::effective() const {
  const std::lock_guard lock(mutex_);
  return effective_;
}

std::vector<Revision> presets_of(const std::vector<std::string>& texts, const std::string& stage,
                                 const std::vector<std::string>& foreign, Parameters& parameters) {
  std::map<std::uint64_t, std::vector<std::string>> by_sweep;
  for (const std::string& text : texts) {
    const auto [sweep, setting] = preset(text);
    const std::string section = setting.substr(0, setting.find('.'));
    if (std::find(foreign.begin(), foreign.end(), section) != foreign.end()) continue;
    by_sweep[sweep].push_back(setting);
  }
  const std::string at_start = parameters.live_values_json();
  std::vector<Revision> revisions;
  std::string values = "{}";
  for (const auto& [sweep, settings] : by_sweep) {
    const std::string place = "--set-at " + std::to_string(sweep);
    values = merged(values, parameters.check_live(settings, place));
    parameters.set_live(values);
    Revision r;
    r.stage = stage;
    r.rev = static_cast<std::uint32_t>(revisions.size() + 1);
    r.from_sweep = sweep;
    r.values_json = values;
    r.by = kPresetBy;
    revisions.push_back(std::move(r));
  }
  parameters.set_live(at_start);
  return revisions;
}

}  // namespace zloam::runtime
