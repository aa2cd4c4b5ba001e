#pragma once
// Changes of configuration while running (docs/protocol.md, section 13), the runtime's side:
// answers command/<stage>/set, publishes config/<stage>, and knows for every stage which revision
// is in force at which sweep. Every process keeps the revisions of all stages and answers gets of
// config/*, so that a restarted stage finds its own revisions in any other process. A change is
// answered when another process keeps it too, or with a warning that none does.
//
// A put under config/<stage> is only a hint: its receiver asks, and the answers of the processes
// that keep the revisions count. So a put by an unknown sender changes nothing.
//
// Everything is called from the worker unless stated otherwise.

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/messages/keys.hpp"
#include "common/runtime/async_get.hpp"
#include "common/runtime/revisions.hpp"
#include "common/runtime/shared.hpp"
#include "common/runtime/short_lives.hpp"
#include "common/runtime/stage.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

struct LiveConfigSetup {
  Identity identity;
  /// maximum of sweeps in flight: a change takes effect twice as many sweeps ahead, so that every
  /// instance receives it in time
  int window = 8;
  /// null: nothing can be changed
  Parameters* parameters = nullptr;
  /// revisions of the first run, from the command line
  std::vector<Revision> presets;
  /// for tests of instances that disagree: revisions of this stage from others are ignored until
  /// this many sweeps after their first one
  std::uint64_t deaf_sweeps = 0;
  /// true: another instance is active and answers
  std::shared_ptr<const std::atomic<bool>> muted = std::make_shared<std::atomic<bool>>(false);
};

/// The configuration that the instance reports.
struct EffectiveValues {
  std::uint32_t rev = 0;
  std::string values_json = "{}";
  /// the part that names a replay, as of the run's first sweep, so that a driver restarted in the
  /// middle computes the same name
  std::string result_json = "{}";
};

class LiveConfig {
 public:
  /// offer: runs a task on the worker; false: too many wait there already.
  LiveConfig(LiveConfigSetup setup, EffectiveValues at_start, const Keys& keys,
             zenoh::Session& session, std::shared_ptr<Shared> bell,
             std::function<bool(std::function<void()>)> offer);

  /// Asks the others for their revisions before it returns.
  void begin_run(std::uint64_t run);
  void end_run();
  void saw(std::uint64_t run, std::uint64_t sweep);
  /// Asks when something new may exist, and takes the answers.
  void tick();
  /// Monotonic ns of the next work.
  std::optional<std::int64_t> deadline() const;

  bool configure_for(std::uint64_t run, std::uint64_t sweep);
  std::uint32_t rev_at(std::uint64_t run, std::uint64_t sweep) const;
  bool agrees(std::string_view stage, const msg::Header& header);
  /// Turns the settings "key=value" into a coming revision.
  CommandReply set(const std::vector<std::string>& settings);

  void answer_set_if(std::function<bool(std::uint64_t run)> mine) { mine_ = std::move(mine); }
  /// Called for a new revision of any stage.
  void on_revision(std::function<void(const Revision&)> task) { on_revision_ = std::move(task); }
  /// Called for a revision of this stage whose first sweeps were already processed.
  void on_late(std::function<void(const Revision&)> task) { on_late_ = std::move(task); }

  /// Any thread.
  EffectiveValues effective() const;

 private:
  void declare();
  void take(const zenoh::Sample& sample);
  bool accept(const Revision& revision);
  bool deaf_to(const Revision& revision) const;
  bool usable(const Revision& revision);
  void keep(const Revision& revision);
  void publish(const Revision& revision);
  void remind(std::string_view stage);
  /// A stage that dies on a revision does not get it again, unless it lives with it elsewhere.
  void hear_token(const std::string& key, bool there);
  void withdraw(const std::string& stage, std::uint32_t rev);
  void answer_set(const std::shared_ptr<zenoh::Query>& query);
  void answer(zenoh::Query& query, const CommandReply& reply);
  void confirm();
  std::ptrdiff_t keepers(const std::vector<zenoh::Sample>& answers, std::uint32_t rev) const;
  /// The fields hold the revision's values during the call.
  void with(const Revision* revision, const std::function<void()>& task);
  void apply(const Revision* revision);
  void refresh();
  Revision next(const std::string& changed_json) const;
  const RevisionSchedule& own() const { return schedules_.at(setup_.identity.stage); }

  /// A change that was made; it is answered when another process keeps it.
  struct Unconfirmed {
    std::shared_ptr<zenoh::Query> query;
    CommandReply reply;
    std::uint32_t rev = 0;
    std::int64_t until_ns = 0;
  };

  LiveConfigSetup setup_;
  Keys keys_;
  zenoh::Session& session_;
  std::shared_ptr<Shared> bell_;
  std::function<bool(std::function<void()>)> offer_;
  std::function<bool(std::uint64_t)> mine_;
  std::function<void(const Revision&)> on_revision_, on_late_;
  /// values of the live parameters at the start of the stage
  std::string base_json_ = "{}";
  std::string presets_text_;
  std::map<std::string, RevisionSchedule, std::less<>> schedules_;
  std::uint32_t applied_ = 0;
  bool in_run_ = false;
  std::uint64_t run_ = 0;
  std::optional<std::uint64_t> newest_seen_, newest_used_;
  ShortLives lives_;
  AsyncGet get_;
  std::vector<Unconfirmed> unconfirmed_;
  AsyncGet confirming_;
  std::int64_t next_confirm_ns_ = 0;
  /// a put announced something new; any thread
  std::atomic<bool> hinted_{false};
  bool to_ask_ = false;
  std::int64_t next_ask_ns_ = 0;
  std::int64_t reminded_ns_ = 0;
  mutable std::mutex mutex_;
  EffectiveValues effective_;
  /// (stage, rev) -> message
  std::map<std::pair<std::string, std::uint32_t>, zenoh::Bytes> kept_;
  // Last: their callbacks must end before the members they use are destroyed.
  std::optional<zenoh::Subscriber> subscriber_, tokens_;
  std::vector<zenoh::Queryable> queryables_;
};

/// "30:key=value" texts as revisions of the stage, from 1; keys in foreign sections are skipped.
/// Throws ConfigError.
std::vector<Revision> presets_of(const std::vector<std::string>& texts, const std::string& stage,
                                 const std::vector<std::string>& foreign, Parameters& parameters);

}  // namespace zloam::runtime
