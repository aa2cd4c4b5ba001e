#pragma once
// The interface for a stage's main.cpp. A stage declares inputs, outputs and commands in one
// function; the runtime handles command line, configuration, session, queues, order, recovery of
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
// Threads: all callbacks of a stage (handlers, commands, answers, polls) run on the one worker
// thread, one after another, so a stage needs no lock. Only notify(), accounts and figures may be
// used from others.

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
  /// for another program that replaces the stage: distinguishes its name (zloam-<variant>-<stage>)
  /// and its section of the robot's file; empty: the stage's own program
  std::string variant = {};
  /// one sentence for --help
  std::string summary;
  /// binds the stage's own parameters
  std::function<void(Parameters&)> bind;
  /// called after the configuration is read and the session is open: declares everything and
  /// returns. An exception ends the process: ConfigError 2, IoError 3, anything else 1.
  std::function<void(Stage&)> wire;
  /// longest time for one sweep: when sweeps come and none is done for longer, a standby instance
  /// takes over
  std::chrono::milliseconds longest_work{1000};
  /// the largest block that the heap keeps for the next sweep when it is freed, at most 32 MiB.
  /// Mapping and clearing a dense sweep's blocks again each time takes a fifth of a stage's time.
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

/// Reply of a command; ok = false: refused, with the reason.
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

/// Result of polling a source: call again at once, or wait for notify() (or the next 20 ms).
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

  /// Publisher with delivery, encoding and numbering as in the key table. Lives as long as the
  /// stage.
  virtual Outlet& outlet(Key key) = 0;
  /// Map tiles: one publisher for all cubes; publish_at() names each.
  virtual Outlet& outlet_at(Key key, const std::string& full_key) = 0;

  /// Paces a finite source by the sinks' acknowledgements, and names the run (driver).
  virtual FlowWindow& flow_window(Outlet& sweeps) = 0;
  /// Reports this sink's progress to the driver (integration, mapping).
  virtual FlowAck& flow_ack(const std::string& sink) = 0;

  /// command/<stage>/<verb>. Exactly one reply; an exception becomes a refusal with its text.
  virtual void command(const std::string& verb, CommandHandler handler) = 0;
  /// Answers gets under the full key (e.g. path/map, map/tile/**).
  virtual void answer(const std::string& full_key, std::function<void(Answer&)> handler) = 0;

  /// Sets the live parameters to the values in force at the message's sweep (docs/protocol.md,
  /// section 13); a handler calls it first. True: they have changed. Headers made for an output
  /// contain the revision.
  virtual bool configure_for(const Message& message) = 0;
  /// The number of that revision, for headers made without a cause.
  virtual std::uint32_t config_rev(std::uint64_t run, std::uint64_t sweep) const = 0;
  /// Whether another stage's output was made with the revision in force at its sweep; if not, the
  /// side that lacks the revision is informed.
  virtual bool revision_agrees(std::string_view other_stage, const msg::Header& header) = 0;
  /// Of several instances, this one answers command/<stage>/set only if `mine` is true.
  virtual void answer_set_if(std::function<bool(std::uint64_t run)> mine) = 0;
  /// A revision arrived after sweeps from its first one on were processed.
  virtual void on_late_revision(
      std::function<void(std::uint64_t run, std::uint64_t from_sweep)> task) = 0;

  /// Called repeatedly between messages: sources, files, pacing.
  virtual void on_poll(std::function<Poll()> poll) = 0;
  /// Called every period on the worker, late when it is busy.
  virtual void every(std::chrono::milliseconds period, std::function<void()> task) = 0;
  /// The last sweep of a run is processed here: write files. Once per run.
  virtual void on_end_of_run(std::function<void(std::uint64_t run)> task) = 0;
  /// A new run begins (also the first): forget the one before. Called before its first message.
  virtual void on_new_run(std::function<void(const msg::Header& first)> task) = 0;
  /// leaves: another instance is about to take over. State that only this one has must be answered
  /// from now on, for the seconds in which the other asks; nothing is published any more. Called
  /// with false if the other does not take over: this one continues.
  virtual void on_hand_over(std::function<void(bool leaves)> task) = 0;
  /// Before the end of the process (signal or stop()): save unsaved data.
  virtual void on_stop(std::function<void()> task) = 0;
  /// A result that could not be written and is given up: reported until the process ends, whose exit
  /// code is then that of a missing file. An empty text is ignored.
  virtual void lost_output(const std::string& what) = 0;
  /// When it is stopped, it first handles what has come and still comes, for at most so long.
  virtual void drain_on_stop(std::chrono::milliseconds at_most) = 0;

  /// Marks the run as ended, for stages whose inlets have ends_run off (they determine the end).
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
  /// A lasting impairment, e.g. a file that can't be written; empty text: it is over. Any thread.
  virtual void degraded(const std::string& topic, const std::string& reason) = 0;
  /// An earlier instance's message had this term: the own term is raised to at least this.
  virtual void note_term(std::uint32_t term) = 0;
  /// This instance took over from one that is still there and may hang.
  virtual bool overtook() const = 0;
  /// The stage's own readiness, e.g. of a socket; the stage is Starting until yes is true.
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
