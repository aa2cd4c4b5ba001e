// A stage's declarations: inputs, outputs, flow control, commands and answers.

#include <nlohmann/json.hpp>

#include "common/runtime/json_guard.hpp"
#include "common/runtime/log.hpp"
#include "common/runtime/query_guard.hpp"
#include "common/runtime/run_id.hpp"
#include "common/runtime/stage_core.hpp"

namespace zloam::runtime {
namespace {

SequencerLimits limits_of(const RecoveryConfig& c, const InletOptions& options) {
  SequencerLimits l;
  l.sweeps = options.sweeps;
  l.replicas = options.replicas;
  l.sparse = options.sparse;
  l.gap_live_ns = c.gap_live_ms * kMs;
  l.gap_replay_ns = c.gap_replay_ms * kMs;
  l.late_ns = c.late_ms * kMs;
  l.replay_limit_ns = kMs * 1000 * c.replay_limit_s;
  l.newest = options.newest > 0 ? options.newest : static_cast<std::size_t>(c.queue_sweeps);
  if (options.lossless) l.newest = 0;
  return l;
}

class QueryAnswer final : public Answer {
 public:
  explicit QueryAnswer(zenoh::Query& query) : query_(query) {}
  const std::string& key() const override { return query_.key(); }
  const std::string& parameters() const override { return query_.parameters(); }
  void reply(const std::string& key, const std::string& encoding, Buffer message) override {
    query_.reply(key, zenoh::Bytes::own(std::move(message)), encoding);
  }
  void refuse(const std::string& reason) override {
    query_.reply_error(zenoh::Bytes::copy_of(reason));
  }

 private:
  zenoh::Query& query_;
};

/// The arguments of a command: a Command message, or bare JSON text (from REST or a shell).
std::string arguments_of(const zenoh::Query& query) {
  const zenoh::AlignedBytes bytes = zenoh::view_aligned(query.payload());
  if (verify<msg::Command>(bytes.data(), encoding_of(Key::kCommand)).ok()) {
    const auto* text = message_of<msg::Command>(bytes.data()).arguments_json();
    return text == nullptr ? "{}" : text->str();
  }
  const std::string text = query.payload().to_string();
  return text.empty() ? "{}" : text;
}

CommandReply call(const CommandHandler& handler, const std::string& arguments) {
  if (const std::string error = json_error(arguments); !error.empty()) return {false, error};
  if (!nlohmann::json::accept(arguments)) return {false, "the arguments are not JSON"};
  try {
    return handler(arguments);
  } catch (const std::exception& e) {
    return {false, e.what()};
  }
}

}  // namespace

// Features are kept longer than other messages: after a standstill, odometry processes the sweeps
// that it missed (up to 5 s) and those that arrive meanwhile.
constexpr std::size_t kFeaturesKeptTimes = 2;

Outlet& StageCore::outlet(Key key) { return outlet_at(key, keys_.of(key)); }

Outlet& StageCore::outlet_at(Key key, const std::string& full_key) {
  OutletSetup s;
  s.row = key;
  s.key = full_key;
  s.robot = setup_.identity.robot;
  s.sensor = setup_.identity.sensor;
  s.stage = setup_.identity.stage;
  s.instance = setup_.identity.instance;
  s.host = setup_.identity.host;
  s.unshared_part = static_cast<std::size_t>(setup_.shared.zenoh.shared_memory_threshold - 1);
  s.keep_messages = static_cast<std::size_t>(setup_.shared.recovery.keep_messages);
  if (key == Key::kFeatures) s.keep_messages *= kFeaturesKeptTimes;
  s.keep_bytes = static_cast<std::size_t>(setup_.shared.recovery.keep_mib) << 20;
  s.config_rev = [this](std::uint64_t run, std::uint64_t sweep) { return config_rev(run, sweep); };
  if (singleton_) s.term = [this] { return singleton_->term(); };
  s.muted = muted_;
  outlets_.push_back(std::make_unique<OutletCore>(std::move(s), session_));
  return *outlets_.back();
}

Inlet& StageCore::add_inlet(Key key, const std::string& full_key, const InletOptions& options,
                            VerifyFunction verify, HeaderFunction header,
                            std::function<Outcome(const Message&)> handler) {
  InletSetup s;
  s.key = full_key;
  s.options = options;
  s.limits = limits_of(setup_.shared.recovery, options);
  s.limits.by_number = key_row(key).numbering != Numbering::kNone;
  s.queue_bytes = static_cast<std::size_t>(setup_.shared.recovery.queue_mib) << 20;
  s.max_bytes = key_row(key).max_bytes;
  s.verify = verify;
  s.header = header;
  s.handler = std::move(handler);
  s.joins_at_once = took_over_;
  s.fault_every = setup_.fault_every;
  InletEvents& events = *this;
  const auto inlet = std::make_shared<InletCore>(std::move(s), bell_, events);
  {
    const std::lock_guard lock(bell_->mutex);
    inlets_.push_back(inlet);
  }
  if (options.keep > 0) {
    queryables_.push_back(session_.declare_queryable(
        full_key, [inlet](zenoh::Query&& query) { inlet->answer_kept(query); }, false));
  }
  const std::lock_guard lock(subscriptions_mutex_);
  subscriptions_.push_back({inlet, std::nullopt});
  subscribe(subscriptions_.back());
  return *inlet;
}

void StageCore::subscribe(Subscription& subscription) {
  const std::shared_ptr<InletCore> inlet = subscription.inlet;
  // Undeclare the old subscriber first: if a session has two on one key, only the first is declared
  // to other sessions.
  subscription.subscriber.reset();
  subscription.subscriber.emplace(session_.declare_subscriber(
      inlet->key(),
      [inlet](zenoh::Sample&& sample) { inlet->on_sample(std::move(sample), false); }));
}

FlowWindow& StageCore::flow_window(Outlet& sweeps) {
  FlowWindowSetup s;
  s.own_stage = setup_.identity.stage;
  s.own_instance = setup_.identity.instance;
  s.muted = muted_;
  s.own_result_hash = sha256_hex(setup_.result_json);
  s.flow = setup_.shared.flow;
  s.limit_ns = kMs * 1000 * setup_.shared.recovery.replay_limit_s;
  auto& outlet = dynamic_cast<OutletCore&>(sweeps);
  window_ = std::make_unique<FlowWindowCore>(std::move(s), keys_, outlet, session_, bell_,
                                             [this](const std::string& r) { fail(r); });
  source_ = &outlet;
  return *window_;
}

FlowAck& StageCore::flow_ack(const std::string& sink) {
  acks_.push_back(
      std::make_unique<FlowAckCore>(keys_, sink, setup_.identity.instance, session_, muted_));
  return *acks_.back();
}

void StageCore::command(const std::string& verb, CommandHandler handler) {
  queryables_.push_back(session_.declare_queryable(
      keys_.command(setup_.identity.stage, verb), [this, verb, handler](zenoh::Query&& query) {
        if (*muted_ || refused_for_size(query)) return;
        const auto shared_query = std::make_shared<zenoh::Query>(std::move(query));
        const auto reply = [this, verb, shared_query](const CommandReply& r) {
          shared_query->reply(keys_.command(setup_.identity.stage, verb),
                              zenoh::Bytes::own(zloam::build(r)), encoding_of(Key::kCommand));
        };
        const bool taken = offer([verb, handler, shared_query, reply] {
          const CommandReply r = call(handler, arguments_of(*shared_query));
          log_info("command", {{"verb", verb}, {"ok", r.ok}, {"message", r.message}});
          reply(r);
        });
        if (!taken) refuse_as_busy(*shared_query, keys_.command(setup_.identity.stage, verb));
      }));
}

void StageCore::answer(const std::string& full_key, std::function<void(Answer&)> handler) {
  queryables_.push_back(session_.declare_queryable(full_key, [this, handler](zenoh::Query&& query) {
    if (*muted_ && !leaving_) return;
    const auto shared_query = std::make_shared<zenoh::Query>(std::move(query));
    const bool taken = offer([handler, shared_query] {
      QueryAnswer answer(*shared_query);
      try {
        handler(answer);
      } catch (const std::exception& e) {
        answer.refuse(e.what());
      }
    });
    if (!taken) QueryAnswer(*shared_query).refuse(kBusy);
  }));
}

}  // namespace zloam::runtime
