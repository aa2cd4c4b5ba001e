#pragma once
// What a stage's main.cpp is written against. A stage declares inputs, outputs and commands in one
// function; the runtime does the command line, configuration, session, queues, order, recovery of
// lost messages, accounts, status, signals and the end.
//
//   int main(int argc, char** argv) {
//     RegistrationConfig config;
//     return runtime::run_stage(argc, argv, {
//       .name = "registration", .summary = "picks features out of sweeps",
//       .bind = [&](Parameters& p) { bind(p, config); },
//       .wire = [&](Stage& stage) {
//         Outlet& out = stage.outlet(Key::kFeatures);
//         stage.inlet<msg::Sweep>(Key::kSweep, {}, [&](const Received<msg::Sweep>& sweep) {
//           auto result = extract(points_of(sweep->points()), config);
//           const HeaderFields header = out.header(sweep);
//           out.publish(header, build(header, FeaturesFields{...}));
//         });
//       }});
//   }
//
// Threads: everything that a stage passes in (handlers, commands, answers, polls) runs on the one
// worker thread, one after another, so a stage needs no lock. Only notify(), accounts and figures
// may be used from others.

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/messages/build.hpp"
#include "common/messages/convert.hpp"
#include "common/messages/header.hpp"
#include "common/messages/keys.hpp"
#include "common/messages/kinds.hpp"
#include "common/messages/verify.hpp"
#include "common/runtime/account.hpp"
#include "common/runtime/config.hpp"
#include "common/runtime/flow.hpp"
#include "common/runtime/inlet.hpp"
#include "common/runtime/log.hpp"
#include "common/runtime/outlet.hpp"
#include "common/runtime/parameters.hpp"

namespace zloam::zenoh {
class Session;
}

namespace zloam::runtime {

class Stage;

struct StageSpec {
  std::string name;
  /// of another program that takes the stage's place: what distinguishes its own name
  /// (zloam-<variant>-<stage>), and its section of the robot's file; empty: the stage's own program
  std::string variant = {};
  /// one sentence for --help
  std::string summary;
  /// binds the stage's own parameters
  std::function<void(Parameters&)> bind;
  /// after the configuration is read and the session is open: declares everything and returns. What
  /// it throws ends the process: ConfigError 2, IoError 3, anything else 1.
  std::function<void(Stage&)> wire;
  /// what one sweep may take: when nothing comes of sweeps for longer, another instance that stands
  /// by goes on in this one's place
  std::chrono::milliseconds longest_work{1000};
  /// the largest block that the heap keeps for the next sweep when it is freed, at most 32 MiB.
  /// Blocks of a dense sweep, mapped and cleared anew each time, are a fifth of a stage's time.
  int kept_block_bytes = 32 << 20;
};

/// Exit codes of every stage.
enum ExitCode : int { kExitOk = 0, kExitFailure = 1, kExitUsage = 2, kExitIo = 3 };

/// Runs until a signal, the end of a source (Stage::stop) or a failure; returns the exit code.
int run_stage(int argc, const char* const* argv, const StageSpec& spec);

struct Identity {
  std::string robot;
  std::string sensor;
  std::string stage;
  std::string instance;
  std::string host;
  std::string version;
};

enum class ServiceHealth : std::uint8_t { kStarting, kReady, kDegraded, kFailed, kStopping };

/// What a command says; ok = false: refused, with the reason.
using CommandReply = CommandReplyFields;
/// arguments: a JSON object.
using CommandHandler = std::function<CommandReply(const std::string& arguments_json)>;

/// A get to be answered with any number of messages.
class Answer {
 public:
  virtual ~Answer() = default;
  /// the key expression asked for, and the text behind '?'
  virtual const std::string& key() const = 0;
  virtual const std::string& parameters() const = 0;
  virtual void reply(const std::string& key, const std::string& encoding, Buffer message) = 0;
  virtual void refuse(const std::string& reason) = 0;
};

/// What a source says when it is polled: more at once, or wait for notify() (or the next 20 ms).
enum class Poll : std::uint8_t { kAgain, kWait };

class Stage {
 public:
  virtual ~Stage() = default;

  virtual const Identity& identity() const = 0;
  virtual const SharedConfig& shared() const = 0;
  virtual const Keys& keys() const = 0;
  virtual zenoh::Session& session() = 0;

  /// Messages of type T under a key that robot and sensor fill. The handler may return void, or an
  /// Outcome.
  template <class T, class Handler>
  Inlet& inlet(Key key, const InletOptions& options, Handler handler) {
    return inlet_at<T>(key, keys().of(key), options, std::move(handler));
  }
  template <class T, class Handler>
  Inlet& inlet_at(Key key, const std::string& full_key, const InletOptions& options,
                  Handler handler);

  /// Publisher with delivery, encoding and numbering as the key table says. Lives as long as the
  /// stage.
  virtual Outlet& outlet(Key key) = 0;
  /// Map tiles: one publisher for all cubes; publish_at() names each.
  virtual Outlet& outlet_at(Key key, const std::string& full_key) = 0;

  /// Paces a finite source by the sinks' acknowledgements, names the run (driver).
  virtual FlowWindow& flow_window(Outlet& sweeps) = 0;
  /// Tells the driver how far this sink has come (integration, mapping).
  virtual FlowAck& flow_ack(const std::string& sink) = 0;

  /// command/<stage>/<verb>. Exactly one reply; an exception becomes a refusal with its text.
  virtual void command(const std::string& verb, CommandHandler handler) = 0;
  /// Answers gets under the full key (e.g. path/map, map/tile/**).
  virtual void answer(const std::string& full_key, std::function<void(Answer&)> handler) = 0;

  /// The live parameters take the values in force at the message's sweep (docs/protocol.md, section
  /// 13): what a handler does first. True: they are others than before. Headers made for an output
  /// say which revision it was.
  virtual bool configure_for(const Message& message) = 0;
  /// That number, for headers made without a cause.
  virtual std::uint32_t config_rev(std::uint64_t run, std::uint64_t sweep) const = 0;
  /// Whether another stage's output was made with the revision in force at its sweep; when not, the
  /// side that has not heard of it is told.
  virtual bool revision_agrees(std::string_view other_stage, const msg::Header& header) = 0;
  /// Of several instances this one answers command/<stage>/set only then.
  virtual void answer_set_if(std::function<bool(std::uint64_t run)> mine) = 0;
  /// A revision came when sweeps from its first one on were worked on already.
  virtual void on_late_revision(
      std::function<void(std::uint64_t run, std::uint64_t from_sweep)> task) = 0;

  /// Called again and again between messages: sources, files, pacing.
  virtual void on_poll(std::function<Poll()> poll) = 0;
  /// Called every period on the worker, late when it is busy.
  virtual void every(std::chrono::milliseconds period, std::function<void()> task) = 0;
  /// The last sweep of a run is processed here: write files. Once per run.
  virtual void on_end_of_run(std::function<void(std::uint64_t run)> task) = 0;
  /// A new run begins (also the first): forget the one before. Called before its first message.
  virtual void on_new_run(std::function<void(const msg::Header& first)> task) = 0;
  /// leaves: another instance is about to go on in this one's place. What only this one knows is to
  /// be answered from now on, for the seconds in which the other asks; nothing is published any more.
  /// Then false, where the other does not: this one goes on.
  virtual void on_hand_over(std::function<void(bool leaves)> task) = 0;
  /// Before the end of the process (signal or stop()): save what is there.
  virtual void on_stop(std::function<void()> task) = 0;

  /// Marks the run as ended, for stages whose inlets have ends_run off (they know best when).
  virtual void end_of_run(std::uint64_t run) = 0;
  /// Wakes the worker. Any thread.
  virtual void notify() = 0;
  /// Ends run_stage after the current message, with kExitOk, or kExitFailure and the reason.
  virtual void stop() = 0;
  virtual void fail(const std::string& reason) = 0;
  virtual bool stopping() const = 0;

  /// Any figure for the status message, its unit in its name. Any thread.
  virtual void figure(const std::string& name, double value) = 0;
  /// Adds a latency sample. Any thread.
  virtual void latency(const std::string& name, double milliseconds) = 0;
  /// A lasting impairment, e.g. a file that can't be written; empty text: over. Any thread.
  virtual void degraded(const std::string& topic, const std::string& reason) = 0;
  /// A message of this stage, of an instance before, had that term: this one's is no less.
  virtual void note_term(std::uint32_t term) = 0;
  /// It works in the place of one that is still there, and may hang.
  virtual bool overtook() const = 0;
  /// Readiness of the stage's own, e.g. a socket; until true is said the stage is Starting.
  virtual void ready(bool yes, const std::string& reason) = 0;
  /// One snapshot of all inputs. Any thread.
  virtual std::vector<Account> accounts() const = 0;
  /// Host clock, ns since the Unix epoch.
  virtual std::int64_t now_ns() const = 0;

 protected:
  virtual Inlet& add_inlet(Key key, const std::string& full_key, const InletOptions& options,
                           VerifyFunction verify, HeaderFunction header,
                           std::function<Outcome(const Message&)> handler) = 0;
};

template <class T, class Handler>
Inlet& Stage::inlet_at(Key key, const std::string& full_key, const InletOptions& options,
                       Handler handler) {
  return add_inlet(
      key, full_key, options, &verify<T>,
      [](std::span<const std::uint8_t> bytes) { return message_of<T>(bytes).header(); },
      [handler = std::move(handler)](const Message& message) -> Outcome {
        const Received<T> received(message);
        if constexpr (std::is_void_v<std::invoke_result_t<const Handler&, const Received<T>&>>) {
          handler(received);
          return Outcome::kProcessed;
        } else {
          return handler(received);
        }
      });
}

}  // namespace zloam::runtime
