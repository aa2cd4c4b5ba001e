#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iterator>
#include <optional>

#include "common/runtime/fault.hpp"
#include "common/runtime/health_query.hpp"
#include "common/runtime/log_setup.hpp"
#include "common/runtime/memory_lock.hpp"
#include "common/runtime/session_config.hpp"
#include "common/runtime/signals.hpp"
#include "common/runtime/stage_core.hpp"
#include "common/runtime/statistics.hpp"

namespace zloam::runtime {
namespace {

std::atomic<int> code_at_end = 0;

// During exit() Zenoh's handlers release its shared memory while one of its threads may still be
// closing a transport that uses it; that thread panics and aborts. So from exit() on, when nothing
// of the stage is left, an abort ends the process with the stage's own exit code.
void keep_exit_code(int code) {
  code_at_end = code;
  std::atexit([] { std::signal(SIGABRT, [](int) { std::_Exit(code_at_end); }); });
}

constexpr const char* kFooter =
    "Configuration: YAML sections robot, sensor, mounting, zenoh, log, flow, recovery and the "
    "stage's "
    "own; --describe-config lists every key with unit, range, default and meaning.\n"
    "Environment: RUST_LOG sets Zenoh's own log.\n"
    "Exit codes: 0 ended as requested; 2 wrong command line or configuration; 3 a file can't be "
    "read "
    "or "
    "written, or a port is taken; 1 anything else.";

struct CommandLine {
  std::optional<std::string> config;
  std::string instance;
  std::vector<std::string> settings, settings_at;
  bool describe = false;
  bool check = false;
  bool health = false;
  bool alive = false;
};

std::string host_name() {
  char name[256] = {};
  if (gethostname(name, sizeof name - 1) != 0 || name[0] == '\0') return "host";
  return clock_fault_ns() == 0 ? name : std::string(name) + "-ahead";
}

std::string program_of(const StageSpec& spec) {
  return "zloam-" + (spec.variant.empty() ? spec.name : spec.variant + "-" + spec.name);
}

/// Parses the command line. If it returns a code, the process ends with it.
std::optional<int> parse(int argc, const char* const* argv, const StageSpec& spec,
                         CommandLine* line) {
  CLI::App app(spec.summary, program_of(spec));
  app.footer(kFooter);
  std::string config;
  app.add_option("--config", config, "the robot's file (YAML); without it all values are defaults");
  app.add_option("--instance", line->instance, "name of this process in keys and status")
      ->default_str("<host>-<pid>");
  app.add_option("--set", line->settings, "key=value; overrides the file; may be repeated")
      ->take_all()
      ->allow_extra_args(false);
  app.add_option("--set-at", line->settings_at,
                 "sweep:key=value; changes a live parameter from this sweep of the first run on, "
                 "as a set command does; may be repeated")
      ->take_all()
      ->allow_extra_args(false);
  app.add_flag("--describe-config", line->describe, "print all parameters as JSON and exit");
  app.add_flag("--check-config", line->check, "check the configuration and exit");
  app.add_flag("--health", line->health,
               "query the instance that runs on this host with this configuration and exit; exit "
               "code 0: it is ready");
  app.add_flag("--alive", line->alive,
               "like --health, but exit code 0: it answers, ready or not; for a supervisor that "
               "ends what fails");
  app.set_version_flag("--version", program_of(spec) + " " ZLOAM_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kExitOk : kExitUsage;
  }
  if (!config.empty()) line->config = config;
  return std::nullopt;
}

Identity identity_of(const StageSpec& spec, const CommandLine& line, const SharedConfig& shared) {
  Identity id;
  id.robot = shared.robot;
  id.sensor = shared.sensor.name;
  id.stage = spec.name;
  id.host = host_name();
  id.instance = line.instance.empty() ? id.host + "-" + std::to_string(getpid()) : line.instance;
  id.version = ZLOAM_VERSION;
  if (const std::string error = Keys::chunk_error(id.instance); !error.empty()) {
    throw ConfigError("--instance: " + error);
  }
  return id;
}

/// The configuration, without shared memory if there is no room for it or it can't be locked.
ZenohConfig shareable(ZenohConfig config) {
  if (!config.shared_memory) return config;
  if (const std::string why = no_place_for_pools(kSharedMemoryFolder, config.pool_mib);
      !why.empty()) {
    log_warning(
        "messages go through sockets: no room for the stages' shared memory (give more, as with "
        "docker's --shm-size, or lower zenoh.pool_mib)",
        {{"reason", why}});
    config.shared_memory = false;
    return config;
  }
  const std::uint64_t bytes = lockable_bytes();
  if (pools_fit(bytes, config.pool_mib)) return config;
  log_warning(
      "messages go through sockets: the stages' shared memory can't be locked (raise ulimit "
      "-l, grant IPC_LOCK, or lower zenoh.pool_mib)",
      {{"lockable_mib", bytes >> 20}, {"pool_mib", config.pool_mib}});
  config.shared_memory = false;
  return config;
}

zenoh::Session open_session(const SharedConfig& shared, const std::string& stage) {
  const Endpoints endpoints = endpoints_of(shared.zenoh, stage);
  ZenohConfig config = shareable(shared.zenoh);
  std::string reason;
  try {
    return zenoh::Session::open(session_config(config, endpoints));
  } catch (const zenoh::ZenohError& e) {
    if (!config.shared_memory) throw;
    reason = e.what();
  }
  // Try again without shared memory: if that fails too, the pool was not the cause.
  config.shared_memory = false;
  zenoh::Session session = zenoh::Session::open(session_config(config, endpoints));
  log_warning("messages go through sockets: no shared memory is to be had", {{"reason", reason}});
  return session;
}

zenoh::Session listening_session(const SharedConfig& shared, const std::string& stage) {
  try {
    return open_session(shared, stage);
  } catch (const zenoh::ZenohError& e) {
    std::string listen;
    for (const std::string& endpoint : endpoints_of(shared.zenoh, stage).listen) {
      listen += (listen.empty() ? "" : ", ") + endpoint;
    }
    throw IoError("can't listen on " + listen + " (zenoh.base_port, zenoh.listen): " + e.what());
  }
}

// Environment variable that tells a process restarted by begin_again() that it was overtaken.
constexpr const char* kOvertaken = "ZLOAM_WAS_OVERTAKEN";

/// Restarts the program in this process: another instance has continued the work meanwhile, so the
/// state of this one is obsolete. Returns only if the restart failed.
void begin_again(const std::vector<const char*>& arguments) {
  setenv(kOvertaken, "1", 1);
  std::fflush(nullptr);
  std::vector<char*> words;
  words.reserve(arguments.size() + 1);
  for (const char* word : arguments) words.push_back(const_cast<char*>(word));
  words.push_back(nullptr);
  execv("/proc/self/exe", words.data());
  log_error("could not begin again", {{"what", std::strerror(errno)}});
}

/// Wires and runs the stage; run_stage() turns its exceptions into exit codes.
int work(const StageSpec& spec, StageSetup setup) {
  const auto start_again = setup.start_again;
  zenoh::init_log("error");
  zenoh::Session session = listening_session(setup.shared, spec.name);
  session.set_error_handler([](std::string_view what) {
    log_error("exception in a callback", {{"what", what}});
  });
  int code = kExitFailure;
  {
    StageCore stage(std::move(setup), session);
    std::optional<SignalWatch> watch;
    watch.emplace([&stage](const char* cause) {
      log_info("stopping", {{"cause", cause}});
      stage.stop();
    });
    if (stage.stand_by()) {
      spec.wire(stage);
      code = stage.run();
    } else {
      stage.close();
      code = kExitOk;
    }
    const bool closed = session.close();
    // A signal that comes from here on stays pending: it is for the process that begins again.
    watch.reset();
    if (stage.begins_again()) {
      log_info("another instance has taken over: beginning again, to stand by");
      start_again();
      code = kExitFailure;
    }
    if (!closed) {
      log_warning("the session did not close in time");
      std::fflush(nullptr);
      _exit(code);
    }
  }
  log_info("ended", {{"code", code}});
  keep_exit_code(code);
  return code;
}

/// Throws IoError if standard output does not take all of it, as a file on a full disk.
void print(const std::string& text) {
  std::printf("%s\n", text.c_str());
  if (std::fflush(stdout) != 0 || std::ferror(stdout) != 0) {
    throw IoError("standard output: the result can't be written");
  }
}

int run(const StageSpec& spec, const CommandLine& line, const std::vector<const char*>& arguments) {
  SharedConfig shared;
  Parameters parameters;
  bind(parameters, shared);
  if (spec.bind) spec.bind(parameters);
  if (line.describe) {
    print(parameters.describe_json());
    return kExitOk;
  }
  // Other programs' sections are skipped, except for the keys that this stage reads as well; an
  // unknown key in the stage's own section is an error.
  std::vector<std::string> foreign = owned_sections();
  std::erase(foreign, spec.variant.empty() ? spec.name : spec.variant);
  parameters.load(line.config, line.settings, foreign);
  std::vector<Revision> presets = presets_of(line.settings_at, spec.name, foreign, parameters);
  if (line.check) {
    print(parameters.values_json());
    return kExitOk;
  }
  if (line.health || line.alive) {
    const HealthAnswer answer = ask_health(shared, spec.name, host_name(), line.instance);
    std::printf("%s\n", answer.text.c_str());
    return (line.alive ? answer.alive : answer.well) ? kExitOk : kExitFailure;
  }
  setup_log(spec.name, shared.log.level, shared.log.format == "json");
  StageSetup setup;
  setup.identity = identity_of(spec, line, shared);
  setup.fault_every = fault("ZLOAM_FAULT_DROP_EVERY").value_or(0);
  setup.fault_deaf_sweeps = fault("ZLOAM_FAULT_DEAF_SWEEPS").value_or(0);
  setup.values_json = parameters.values_json();
  setup.result_json = parameters.result_values_json();
  setup.parameters = &parameters;
  setup.presets = std::move(presets);
  setup.longest_work = spec.longest_work;
  setup.was_overtaken = std::getenv(kOvertaken) != nullptr;
  // Only the first process hangs: the restarted one shall be seen to work.
  if (!setup.was_overtaken) setup.fault_hang_at_sweep = fault("ZLOAM_FAULT_HANG_AT_SWEEP");
  setup.start_again = [arguments] { begin_again(arguments); };
  // Copied, not moved: the parameters are bound to the fields of the local one.
  setup.shared = shared;
  return work(spec, std::move(setup));
}

}  // namespace

int run_stage(int argc, const char* const* argv, const StageSpec& spec) {
  block_stop_signals();
  CommandLine line;
  if (const auto code = parse(argc, argv, spec, &line)) return *code;
  setup_log(spec.name, "info", false);
  bound_heap(spec.kept_block_bytes);
  try {
    return run(spec, line, {argv, argv + argc});
  } catch (const ConfigError& e) {
    log_error(e.what());
    return kExitUsage;
  } catch (const IoError& e) {
    log_error(e.what());
    return kExitIo;
  } catch (const std::exception& e) {
    log_error(e.what());
    return kExitFailure;
  }
}

}  // namespace zloam::runtime
