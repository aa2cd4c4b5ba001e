// One stage and another session: which queries and commands it answers, and what its status says.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <thread>

#include "common/runtime/host_times.hpp"
#include "common/runtime/run_id.hpp"
#include "common/runtime/tests/support.hpp"

namespace zloam::runtime {
namespace {

using test::kKeys;
using test::kPatience;
using test::Network;
using test::RunningStage;
using test::setup;
using test::sweep_header;
using test::Watched;

zenoh::GetOptions patient() {
  zenoh::GetOptions o;
  o.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
  return o;
}

TEST(Outlet, AnswersByNumberWithTheBytesThatWerePublished) {
  const Network network(2);
  constexpr int kKeep = 5;
  StageSetup s = setup("driver");
  s.shared.recovery.keep_messages = kKeep;
  std::vector<std::string> sent;
  RunningStage stage(network.open(0), std::move(s), [&](Stage& core) {
    Outlet& out = core.outlet(Key::kSweep);
    for (std::uint64_t i = 0; i < 8; ++i) {
      HeaderFields h = out.header(core.now_ns(), core.now_ns());
      EXPECT_EQ(h.seq, i);
      h.run = 42;
      h.sweep = i;
      h.frame = "lidar";
      Buffer message = build(h, SweepFields{});
      sent.emplace_back(reinterpret_cast<const char*>(message.data()), message.size());
      out.publish(h, std::move(message));
    }
  });
  zenoh::Session asker = network.open(1);
  const auto ask = [&](const std::string& parameters) {
    std::vector<std::string> bytes;
    for (const zenoh::Reply& r : asker.get(kKeys.of(Key::kSweep) + parameters, patient())) {
      if (!r.ok()) continue;
      EXPECT_EQ(r.sample->encoding, encoding_of(Key::kSweep));
      bytes.push_back(r.sample->payload.to_string());
    }
    return bytes;
  };
  // The link comes up in the background: ask until the first answer.
  std::vector<std::string> one;
  for (int attempt = 0; attempt < 1000 && one.empty(); ++attempt) {
    one = ask("?run=42;sweep=6");
    if (one.empty()) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_EQ(one, std::vector<std::string>{sent[6]});
  // 0 to 2 are not kept any more.
  EXPECT_THAT(ask("?run=42;sweep=0..4"), testing::UnorderedElementsAre(sent[3], sent[4]));
  EXPECT_THAT(ask("?run=42;sweep=7..1000"), testing::UnorderedElementsAre(sent[7]));
  EXPECT_TRUE(ask("?run=43;sweep=0..7").empty());
  EXPECT_THAT(ask("?seq=5..5"), testing::UnorderedElementsAre(sent[5]));
  EXPECT_TRUE(ask("?run=42;sweep=x..y").empty());
  EXPECT_TRUE(ask("").empty());
}

struct Service : testing::Test {
  Service() {
    StageSetup s = setup("mapping", "m1");
    s.values_json = R"({"mapping.every":1})";
    s.result_json = R"({"mapping.every":1})";
    stage = std::make_unique<RunningStage>(network.open(1), std::move(s), [](Stage& core) {
      core.figure("map_points", 12.0);
      core.command("save", [](const std::string& arguments) {
        const auto json = nlohmann::json::parse(arguments);
        if (!json.contains("path")) return CommandReply{false, "path is missing"};
        return CommandReply{true, "saved to " + json["path"].get<std::string>(), R"({"n":1})"};
      });
      core.command("break",
                   [](const std::string&) -> CommandReply { throw std::runtime_error("broken"); });
    });
    client = std::make_unique<zenoh::Session>(network.open(0));
  }
  /// Asks until an answer is good; returns the answers.
  std::vector<zenoh::Reply> ask(const std::string& selector, const std::string& payload = {}) {
    zenoh::GetOptions options = patient();
    if (!payload.empty()) options.payload = zenoh::Bytes::copy_of(payload);
    for (int attempt = 0; attempt < 1000; ++attempt) {
      auto replies = client->get(selector, options);
      // While the link is being made, the transport itself may answer with an error
      if (!replies.empty() && replies[0].ok()) return replies;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return {};
  }
  CommandReply command(const std::string& verb, const std::string& payload) {
    const auto replies = ask(kKeys.command("mapping", verb), payload);
    EXPECT_EQ(replies.size(), 1U);
    if (replies.empty() || !replies[0].ok()) return {false, "no reply"};
    const auto bytes = zenoh::view_aligned(replies[0].sample->payload);
    const auto& reply = *flatbuffers::GetRoot<msg::CommandReply>(bytes.data().data());
    return {reply.ok(), reply.message()->str(), reply.results_json()->str()};
  }
  Network network{2};
  std::unique_ptr<RunningStage> stage;
  std::unique_ptr<zenoh::Session> client;
};

TEST_F(Service, AnswersStatus) {
  const auto replies = ask(kKeys.status("mapping", "*"));
  ASSERT_EQ(replies.size(), 1U);
  ASSERT_TRUE(replies[0].ok());
  EXPECT_EQ(replies[0].sample->key, kKeys.status("mapping", "m1"));
  const auto bytes = zenoh::view_aligned(replies[0].sample->payload);
  ASSERT_TRUE(verify<msg::Status>(bytes.data(), replies[0].sample->encoding).ok());
  const auto& status = message_of<msg::Status>(bytes.data());
  EXPECT_EQ(status.health(), msg::ServiceHealth::Ready);
  EXPECT_EQ(status.stage()->str(), "mapping");
  EXPECT_EQ(status.host()->str(), "testhost");
  EXPECT_EQ(status.pid(), static_cast<std::uint32_t>(getpid()));
  EXPECT_GT(status.rss_now_mib(), 1.0);
  EXPECT_GE(status.rss_peak_mib(), status.rss_now_mib() * 0.5);
  std::map<std::string, double> figures;
  for (const auto* figure : *status.figures()) figures[figure->name()->str()] = figure->value();
  EXPECT_EQ(figures.at("map_points"), 12.0);
  EXPECT_GT(figures.at("rss_anon_mib"), 0.0);
  EXPECT_GE(figures.at("rss_shm_mib"), 0.0);
}

TEST_F(Service, AnswersItsConfigurationWithAHash) {
  const auto replies = ask(kKeys.config("mapping", "m1"));
  ASSERT_EQ(replies.size(), 1U);
  const auto bytes = zenoh::view_aligned(replies[0].sample->payload);
  ASSERT_TRUE(verify<msg::EffectiveConfig>(bytes.data(), replies[0].sample->encoding).ok());
  const auto& config = message_of<msg::EffectiveConfig>(bytes.data());
  EXPECT_EQ(config.values_json()->str(), R"({"mapping.every":1})");
  EXPECT_EQ(config.result_hash()->str(), sha256_hex(R"({"mapping.every":1})"));
}

TEST_F(Service, ACommandHasExactlyOneReply) {
  const CommandReply saved = command("save", R"({"path":"a.pcd"})");
  EXPECT_TRUE(saved.ok);
  EXPECT_EQ(saved.message, "saved to a.pcd");
  EXPECT_EQ(saved.results_json, R"({"n":1})");
  const CommandReply refused = command("save", "{}");
  EXPECT_FALSE(refused.ok);
  EXPECT_EQ(refused.message, "path is missing");
  EXPECT_FALSE(command("save", "not json").ok);
  const CommandReply broken = command("break", "{}");
  EXPECT_FALSE(broken.ok);
  EXPECT_EQ(broken.message, "broken");
}

TEST_F(Service, RefusesACommandThatNoParserShouldSee) {
  const std::vector<std::string> payloads = {
      std::string(8'000'000, ' '), std::string(60'000, '['),
      R"({"path":)" + std::string(30'000, '[') + std::string(30'000, ']') + "}"};
  for (const std::string& payload : payloads) {
    const CommandReply reply = command("save", payload);
    EXPECT_FALSE(reply.ok);
    EXPECT_THAT(reply.message, testing::HasSubstr("read"));
  }
  EXPECT_TRUE(command("save", R"({"path":"a.pcd"})").ok);
}

TEST_F(Service, ItsTokenGoesWithIt) {
  Watched<std::vector<zenoh::SampleKind>> events;
  const auto subscriber = client->declare_liveliness_subscriber(
      kKeys.alive("mapping", "*"), [&](zenoh::Sample&& sample) {
        events.change([&](auto& list) { list.push_back(sample.kind); });
      });
  ASSERT_TRUE(events.wait([](const auto& list) { return !list.empty(); }));
  EXPECT_EQ(events.get().back(), zenoh::SampleKind::kPut);
  stage->stop();
  EXPECT_TRUE(
      events.wait([](const auto& list) { return list.back() == zenoh::SampleKind::kDelete; }));
}

TEST(Readiness, WaitsForTheReaderOfEachOutput) {
  const Network network(2);
  StageSetup s = setup("registration");
  s.shared.flow.wait_for = {"odometry"};
  RunningStage stage(network.open(0), std::move(s),
                     [](Stage& core) { core.outlet(Key::kFeatures); });
  zenoh::Session other = network.open(1);
  Watched<int> statuses;
  Watched<std::pair<msg::ServiceHealth, std::string>> last;
  const auto subscriber =
      other.declare_subscriber(kKeys.status("registration", "*"), [&](zenoh::Sample&& sample) {
        const auto bytes = zenoh::view_aligned(sample.payload);
        const auto& status = message_of<msg::Status>(bytes.data());
        last.change([&](auto& l) { l = {status.health(), status.reason()->str()}; });
      });
  ASSERT_TRUE(last.wait([](const auto& l) { return !l.second.empty(); }));
  EXPECT_EQ(last.get().first, msg::ServiceHealth::Starting);
  EXPECT_THAT(last.get().second, testing::HasSubstr("features"));
  const auto odometry = other.declare_subscriber(kKeys.of(Key::kFeatures), [](zenoh::Sample&&) {});
  EXPECT_TRUE(last.wait([](const auto& l) { return l.first == msg::ServiceHealth::Ready; }));
}

// For ThreadSanitizer: the status names the term, also of a stage that is ending.
TEST(Status, IsAnsweredWhileTheStageEnds) {
  const Network network(2);
  zenoh::Session asker = network.open(1);
  for (int round = 0; round < 3; ++round) {
    RunningStage stage(network.open(0), setup("mapping"), [](Stage&) {});
    std::atomic<bool> ended{false};
    Watched<int> answers;
    std::thread asking([&] {
      while (!ended) {
        for (const zenoh::Reply& reply : asker.get(kKeys.status("mapping", "*"))) {
          if (reply.ok()) answers.change([](int& n) { ++n; });
        }
      }
    });
    EXPECT_TRUE(answers.wait([](int n) { return n > 10; }));
    EXPECT_EQ(stage.stop(), 0);
    ended = true;
    asking.join();
  }
}

// A driver in a container has another host name after each restart.
TEST(HostTimes, HostsThatHaveGoneMakeRoomForOthers) {
  const Network network(1);
  zenoh::Session session = network.open(0);
  HostTimes times(setup("odometry").identity, kKeys, session);
  const auto comes_from = [&times](int host) {
    HeaderFields h = sweep_header(1, 0, false);
    h.trace.push_back({"driver", "host-" + std::to_string(host), "d", 1, 1, 1});
    const Buffer message = build(h, SweepFields{.rings = 16});
    const std::span<const std::uint8_t> bytes(message.data(), message.size());
    times.since_last_packet_ms(*message_of<msg::Sweep>(bytes).header(), 2);
  };
  for (int host = 0; host < 16; ++host) comes_from(host);
  EXPECT_EQ(times.not_asked(), 0U);
  comes_from(16);
  EXPECT_EQ(times.not_asked(), 1U);
  times.ask(steady_ns());
  comes_from(17);
  EXPECT_EQ(times.not_asked(), 2U);
  times.ask(steady_ns() + 120'000 * kMs);
  comes_from(18);
  EXPECT_EQ(times.not_asked(), 2U);
}

TEST(Status, ASourceSaysHowFarItIs) {
  const Network network(1);
  Watched<bool> done;
  RunningStage driver(network.open(0), setup("driver"), [&](Stage& stage) {
    Outlet& out = stage.outlet(Key::kSweep);
    FlowWindow& window = stage.flow_window(out);
    window.start_live();
    stage.on_poll([&, sweep = std::uint64_t{0}]() mutable {
      if (sweep == 3) return Poll::kWait;
      HeaderFields header = out.header(1, 1);
      header.run = window.run();
      header.sweep = sweep++;
      header.end_of_run = sweep == 3;
      out.publish(header, build(header, SweepFields{.rings = 16}));
      done.change([&](bool& d) { d = sweep == 3; });
      return Poll::kAgain;
    });
  });
  ASSERT_TRUE(done.wait([](bool d) { return d; }));
  const StatusFields status = driver->status();
  EXPECT_TRUE(status.has_sweep);
  EXPECT_EQ(status.last_sweep, 2U);
  EXPECT_TRUE(status.end_of_run);
  EXPECT_NE(status.run, 0U);
  EXPECT_GT(status.figures.at("rss_anon_mib"), 0.0);
}

}  // namespace
}  // namespace zloam::runtime
