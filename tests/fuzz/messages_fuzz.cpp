// Runs each stage with its runtime on the fuzzer's network: messages of every schema on every key,
// tokens, commands, and answers to the stage's gets. Nothing may crash, and every message that the
// stage publishes must be within its ranges.
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <mutex>
#include <optional>

#include "common/runtime/log_setup.hpp"
#include "common/runtime/stage_core.hpp"
#include "driver/driver_stage.hpp"
#include "integration/integration_stage.hpp"
#include "mapping/mapping_stage.hpp"
#include "messages.hpp"
#include "network.hpp"
#include "odometry/odometry_parameters.hpp"
#include "odometry/odometry_stage.hpp"
#include "registration/registration_parameters.hpp"
#include "registration/registration_stage.hpp"
#include "store/store_parameters.hpp"
#include "store/store_stage.hpp"

using namespace zloam;
using runtime::Parameters;
using runtime::Stage;

namespace {

constexpr std::size_t kMostEvents = 24;
constexpr int kTurnsAtEnd = 4;

const Keys kKeys("r", "top");
std::string store_folder;
std::unique_ptr<fuzz::MessageMaker> maker;

struct Driven {
  std::string name;
  std::vector<Key> inputs;
  std::function<void(Parameters&)> bind;
  std::function<void(Stage&)> wire;
  std::shared_ptr<void> parts;
};

/// Binds a config, lets `prepare` change it, and passes it to the stage with its other arguments.
template <class Made, class Config, class... More>
Driven driven(const std::string& name, std::vector<Key> inputs, auto prepare) {
  struct Parts {
    Config config;
    std::tuple<More...> more;
    std::unique_ptr<Made> stage;
  };
  const auto parts = std::make_shared<Parts>();
  std::apply([&](More&... more) { prepare(parts->config, more...); }, parts->more);
  Parts* p = parts.get();
  constexpr bool kTogether = requires(Parameters & b, Config & c, More & ... m) {
    bind(b, c, m...);
  };
  return {name, std::move(inputs),
          [p](Parameters& b) {
            std::apply(
                [&](More&... m) {
                  if constexpr (kTogether) {
                    bind(b, p->config, m...);
                  } else {
                    bind(b, p->config);
                    (bind(b, m), ...);
                  }
                },
                p->more);
          },
          [p](Stage& s) {
            std::apply([&](More&... m) { p->stage = std::make_unique<Made>(s, p->config, m...); },
                       p->more);
          },
          parts};
}

constexpr auto kAsItIs = [](auto&...) {};

Driven pick(std::uint8_t choice) {
  using driver::DriverConfig;
  using store::StoreConfig;
  switch (choice % 6) {
    case 0:
      return driven<registration::RegistrationStage, registration::RegistrationConfig,
                    registration::SharingConfig>("registration", {Key::kSweep}, kAsItIs);
    case 1:
      return driven<odometry::OdometryStage, odometry::OdometryConfig>("odometry", {Key::kFeatures},
                                                                       kAsItIs);
    case 2:
      return driven<mapping::MappingStage, mapping::MappingConfig, mapping::OutputConfig>(
          "mapping", {Key::kOdometryFeatures},
          [](mapping::MappingConfig&, mapping::OutputConfig& o) { o.map_path.clear(); });
    case 3:
      return driven<integration::IntegrationStage, integration::IntegrationConfig>(
          "integration", {Key::kOdometry, Key::kMapCorrection},
          [](integration::IntegrationConfig& c) { c.output_dir.clear(); });
    case 4:
      return driven<driver::DriverStage, DriverConfig>("driver", {Key::kPackets, Key::kImu},
                                                       [](DriverConfig& c) {
                                                         c.source = driver::SourceKind::kZenoh;
                                                         c.imu = driver::ImuChoice::kZenoh;
                                                       });
    default:
      return driven<store::StoreStage, StoreConfig>("store", {Key::kMapTile, Key::kMapOdometry},
                                                    [](StoreConfig& c) { c.path = store_folder; });
  }
}

std::string schema_of(Key key) { return std::string(key_row(key).schema); }

fuzz::NetMessage message_on(const std::string& key, Key kind, fuzz::Input& in) {
  return {key, encoding_of(kind), maker->make(schema_of(kind), in)};
}

std::string name_of(Key key) {
  switch (key) {
    case Key::kMapTile:
      return kKeys.tile("planes", 0, 0, 0);
    case Key::kFlowAck:
      return kKeys.flow_ack("mapping");
    case Key::kConfigRevision:
      return kKeys.config_revision("mapping");
    default:
      return kKeys.of(key);
  }
}

/// The answers to a get on the key.
std::vector<fuzz::NetMessage> answers(std::string_view asked, fuzz::Input& in) {
  std::vector<fuzz::NetMessage> out;
  const auto give = [&](Key kind, const std::string& key) {
    for (int left = in.byte() % 4; left > 0 && !in.ended(); --left) {
      out.push_back(message_on(key, kind, in));
    }
  };
  for (const Key key : {Key::kSweep, Key::kFeatures, Key::kOdometry, Key::kOdometryFeatures,
                        Key::kMapCorrection, Key::kMapOdometry, Key::kPose}) {
    if (asked == kKeys.of(key)) give(key, kKeys.of(key));
  }
  if (asked == kKeys.all_tiles()) give(Key::kMapTile, name_of(Key::kMapTile));
  if (asked == kKeys.config_revision("*")) {
    give(Key::kConfigRevision, name_of(Key::kConfigRevision));
  }
  if (asked.ends_with("/time")) give(Key::kTime, std::string(asked));
  if (asked.ends_with("/config")) give(Key::kConfig, std::string(asked));
  return out;
}

template <class T>
std::string fault_of(std::string_view encoding, std::span<const std::uint8_t> bytes) {
  if (encoding != encoding_of_schema(Kind<T>::kSchema)) return {};
  return verify<T>(bytes, encoding).reason;
}

/// Checks a published message as its receivers do; a fault aborts.
void check_output(std::string_view encoding, std::span<const std::uint8_t> bytes) {
  for (const std::string& fault :
       {fault_of<msg::Sweep>(encoding, bytes), fault_of<msg::Features>(encoding, bytes),
        fault_of<msg::Odometry>(encoding, bytes), fault_of<msg::OdometryFeatures>(encoding, bytes),
        fault_of<msg::MapCorrection>(encoding, bytes), fault_of<msg::MapPose>(encoding, bytes),
        fault_of<msg::MapTile>(encoding, bytes), fault_of<msg::Progress>(encoding, bytes),
        fault_of<msg::ConfigRevision>(encoding, bytes), fault_of<msg::Status>(encoding, bytes)}) {
    if (fault.empty()) continue;
    std::fprintf(stderr, "published: %s: %s\n", std::string(encoding).c_str(), fault.c_str());
    std::abort();
  }
}

/// Passes a message to the reader of any schema, including those that no stage subscribes to.
void read_any(fuzz::Input& in) {
  const KeyRow& row = key_table()[in.byte() % key_table().size()];
  if (row.schema.empty()) return;
  const auto bytes = maker->make(std::string(row.schema), in);
  std::vector<std::uint64_t> aligned(bytes.size() / 8 + 1);
  std::copy(bytes.begin(), bytes.end(), reinterpret_cast<std::uint8_t*>(aligned.data()));
  const std::span span(reinterpret_cast<const std::uint8_t*>(aligned.data()), bytes.size());
  const std::string encoding = encoding_of(row.key);
  fault_of<msg::Cloud>(encoding, span);
  fault_of<msg::Command>(encoding, span);
  fault_of<msg::EffectiveConfig>(encoding, span);
  fault_of<msg::FlowAck>(encoding, span);
  fault_of<msg::GnssBatch>(encoding, span);
  fault_of<msg::GraphPoses>(encoding, span);
  fault_of<msg::HostTime>(encoding, span);
  fault_of<msg::ImuBatch>(encoding, span);
  fault_of<msg::Loop>(encoding, span);
  fault_of<msg::Packets>(encoding, span);
  fault_of<msg::Path>(encoding, span);
  fault_of<msg::Preview>(encoding, span);
  fault_of<msg::Rejected>(encoding, span);
  fault_of<msg::Status>(encoding, span);
  fault_of<msg::Submap>(encoding, span);
}

void send_token(fuzz::Input& in) {
  const std::uint8_t choice = in.byte();
  const std::string who = choice % 8 == 0 ? in.text(8) : "d";
  const bool there = choice % 3 != 0;
  const std::string prefix = "loam/r/service/";
  switch (choice / 8 % 4) {
    case 0:
      return fuzz::send_token(prefix + "driver/" + who + "/run/7", there);
    case 1:
      return fuzz::send_token(prefix + "registration/" + who + "/alive", there);
    case 2:
      return fuzz::send_token(prefix + "mapping/" + who + "/alive", there);
    default:
      return fuzz::send_token(prefix + "driver/" + who + "/run/" + in.text(20), there);
  }
}

void ask(const std::string& stage, fuzz::Input& in) {
  static constexpr const char* kVerbs[] = {"set", "save", "reset", "place"};
  const std::uint8_t choice = in.byte();
  const std::string verb = kVerbs[choice % std::size(kVerbs)];
  const std::string text = in.text(60);
  switch (choice / 3 % 4) {
    case 0:
      return fuzz::ask({kKeys.command(stage, verb), {}, {text.begin(), text.end()}}, {});
    case 1:
      return fuzz::ask({kKeys.command(stage, verb), encoding_of(Key::kCommand),
                        maker->make(schema_of(Key::kCommand), in)},
                       {});
    case 2:
      return fuzz::ask({"loam/r/**", {}, {}}, choice % 2 == 0 ? "run=7;sweep=0..5" : text);
    default:
      return fuzz::ask({"loam/r/**", {}, {}}, {});
  }
}

void send_any(fuzz::Input& in) {
  static constexpr Key kOf[] = {Key::kProgress,      Key::kFlowAck,  Key::kConfigRevision,
                                Key::kSweep,         Key::kFeatures, Key::kOdometryFeatures,
                                Key::kMapCorrection, Key::kMapTile,  Key::kMapOdometry,
                                Key::kOdometry,      Key::kPackets,  Key::kImu};
  const std::uint8_t where = in.byte(), what = in.byte();
  const Key key = kOf[where % std::size(kOf)];
  fuzz::send(message_on(name_of(key), what < 200 ? key : kOf[what % std::size(kOf)], in));
}

void event(const Driven& stage, fuzz::Input& in) {
  const std::uint8_t choice = in.byte();
  if (choice < 176) {
    const Key key = stage.inputs[choice % stage.inputs.size()];
    return fuzz::send(message_on(name_of(key), key, in));
  }
  if (choice < 192) return send_token(in);
  if (choice < 216) return ask(stage.name, in);
  if (choice < 232) return read_any(in);
  send_any(in);
}

runtime::StageSetup setup_of(const Driven& stage, runtime::SharedConfig shared,
                             Parameters& parameters) {
  shared.robot = kKeys.robot();
  shared.sensor.name = kKeys.sensor();
  runtime::StageSetup setup;
  setup.identity = {kKeys.robot(), kKeys.sensor(), stage.name, "i", "host", "0"};
  setup.shared = std::move(shared);
  setup.parameters = &parameters;
  return setup;
}

void drive(Driven stage, fuzz::Input in) {
  runtime::SharedConfig shared;
  Parameters parameters;
  bind(parameters, shared);
  stage.bind(parameters);
  const auto worker = std::this_thread::get_id();
  fuzz::set_network({[&](std::string_view key) {
                       // gets of the status thread must not consume the fuzzer's bytes
                       if (std::this_thread::get_id() == worker) return answers(key, in);
                       return std::vector<fuzz::NetMessage>();
                     },
                     check_output});
  zenoh::Session session = zenoh::Session::open(zenoh::Config::create_default());
  runtime::StageCore core(setup_of(stage, shared, parameters), session);
  stage.wire(core);
  std::size_t events = 0;
  int turns_left = kTurnsAtEnd;
  core.on_poll([&] {
    if (!in.ended() && events++ < kMostEvents) {
      event(stage, in);
    } else if (--turns_left <= 0) {
      core.stop();
    }
    return runtime::Poll::kAgain;
  });
  core.run();
  for (const runtime::Account& account : core.accounts()) {
    if (!account.balanced()) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char*** argv) {
  const std::filesystem::path program((*argv)[0]);
  maker = std::make_unique<fuzz::MessageMaker>((program.parent_path() / "schemas").string());
  store_folder = "/dev/shm/zloam-fuzz-" + std::to_string(getpid());
  runtime::setup_log("fuzz", "off", false);
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzz::Input in({data, size});
  maker->restart();
  const std::uint8_t choice = in.byte();
  try {
    drive(pick(choice), in);
  } catch (const runtime::IoError&) {
  }
  if (choice % 6 == 5) std::filesystem::remove_all(store_folder);
  return 0;
}
