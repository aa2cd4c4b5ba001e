// One stage and another session: which messages are refused, which queries are answered, and how
// the accounts count them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <set>

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
using test::wait_for_reader;
using test::Watched;

zenoh::PublisherOptions sweep_options() {
  zenoh::PublisherOptions o;
  o.congestion_control = zenoh::CongestionControl::kBlock;
  o.encoding = encoding_of(Key::kSweep);
  return o;
}

zenoh::GetOptions patient() {
  zenoh::GetOptions o;
  o.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
  return o;
}

zenoh::Bytes sweep_bytes(const HeaderFields& header, std::span<const Point> points = {}) {
  return zenoh::Bytes::own(build(header, SweepFields{.points = points, .rings = 16}));
}

/// A stage that records the sweeps that it handles.
struct Reader {
  Reader(zenoh::Session session, StageSetup s, InletOptions options = {}) {
    options.on_given_up = [this](std::uint64_t, std::uint64_t sweep, std::string_view reason) {
      seen.change([&](auto& list) { list.push_back(std::string(reason) + std::to_string(sweep)); });
    };
    stage = std::make_unique<RunningStage>(std::move(session), std::move(s), [&](Stage& core) {
      core.inlet<msg::Sweep>(Key::kSweep, options, [this](const Received<msg::Sweep>& sweep) {
        hold.wait([](bool held) { return !held; });
        seen.change([&](auto& list) { list.push_back(std::to_string(sweep.sweep())); });
      });
    });
  }
  Account account() { return (*stage)->accounts().at(0); }
  bool wait_for(std::size_t n) {
    return seen.wait([n](const auto& list) { return list.size() >= n; });
  }
  Watched<std::vector<std::string>> seen;
  Watched<bool> hold;
  std::unique_ptr<RunningStage> stage;
};

std::uint64_t dropped(const Account& a, Drop reason) {
  return a.dropped[static_cast<std::size_t>(reason)];
}

TEST(Stage, RefusesWhatIsNoMessageAndCountsWhy) {
  const Network network(2);
  Reader reader(network.open(0), setup("registration"));
  zenoh::Session stranger = network.open(1);
  zenoh::Publisher good = stranger.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  zenoh::PublisherOptions wrong = sweep_options();
  wrong.encoding = "text/plain";
  zenoh::Publisher other = stranger.declare_publisher(kKeys.of(Key::kSweep), wrong);
  wait_for_reader(good);
  wait_for_reader(other);

  good.put(sweep_bytes(sweep_header(1, 0, true)));
  other.put(sweep_bytes(sweep_header(1, 1, true)));                                // encoding
  good.put(zenoh::Bytes::copy_of(std::string_view("no message")));                 // no FlatBuffer
  good.put(zenoh::Bytes());                                                        // nothing at all
  good.put(zenoh::Bytes::own(build(sweep_header(1, 1, true), FeaturesFields{})));  // identifier
  const Buffer whole = build(sweep_header(1, 1, true), SweepFields{});
  good.put(zenoh::Bytes::copy_of(std::span(whole.data(), whole.size() / 2)));  // cut
  const std::vector<Point> bad = {{1, 1, 1, 1, 0, 99, ReturnType::kStrongest, 0}};
  good.put(sweep_bytes(sweep_header(1, 1, true), bad));  // ring out of range
  good.put(sweep_bytes(sweep_header(1, 0, true)));       // second copy
  good.put(sweep_bytes(sweep_header(1, 1, true)));
  ASSERT_TRUE(reader.wait_for(2));
  reader.stage->stop();
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.received, 9U);
  EXPECT_EQ(a.processed, 2U);
  EXPECT_EQ(dropped(a, Drop::kGarbage), 5U);
  EXPECT_EQ(dropped(a, Drop::kInvalid), 1U);
  EXPECT_EQ(dropped(a, Drop::kDuplicate), 1U);
  EXPECT_THAT(reader.seen.get(), testing::ElementsAre("0", "1"));
}

TEST(Stage, RefusesWhatIsLargerThanAnyMessageOfTheKey) {
  const Network network(2);
  RunningStage stage(network.open(0), setup("integration"), [](Stage& core) {
    core.inlet<msg::Odometry>(Key::kOdometry, {}, [](const Received<msg::Odometry>&) {});
  });
  zenoh::Session stranger = network.open(1);
  zenoh::PublisherOptions options = sweep_options();
  options.encoding = encoding_of(Key::kOdometry);
  zenoh::Publisher out = stranger.declare_publisher(kKeys.of(Key::kOdometry), options);
  wait_for_reader(out);
  const std::size_t most = key_row(Key::kOdometry).max_bytes;
  // The message is well formed, so only its size can be the reason of the drop.
  HeaderFields header = sweep_header(1, 0, true);
  header.frame = std::string(most, 'x');
  out.put(zenoh::Bytes::own(build(header, OdometryFields{})));
  header.frame = "odom";
  out.put(zenoh::Bytes::own(build(header, OdometryFields{})));
  while (stage->accounts().at(0).processed == 0) std::this_thread::yield();
  stage.stop();
  const Account a = stage->accounts().at(0);
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.received, 2U);
  EXPECT_EQ(a.processed, 1U);
  EXPECT_EQ(dropped(a, Drop::kGarbage), 1U);
}

TEST(Stage, LiveQueueDropsTheOldestAndTellsWhich) {
  const Network network(2);
  StageSetup s = setup("registration");
  s.shared.recovery.queue_sweeps = 2;
  Reader reader(network.open(0), std::move(s));
  reader.hold.change([](bool& h) { h = true; });
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  constexpr std::uint64_t kSent = 9;
  for (std::uint64_t i = 0; i < kSent; ++i) out.put(sweep_bytes(sweep_header(1, i, false)));
  // Wait for the counter instead of a fixed time: it shows when all messages have arrived.
  while (reader.account().received < kSent) std::this_thread::yield();
  reader.hold.change([](bool& h) { h = false; });
  ASSERT_TRUE(reader.wait_for(kSent));
  reader.stage->stop();
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.processed + dropped(a, Drop::kQueueFull), kSent);
  EXPECT_GE(dropped(a, Drop::kQueueFull), 4U);
  EXPECT_EQ(reader.seen.get().back(), "8");
  std::uint64_t told = 0;
  for (const std::string& entry : reader.seen.get()) told += entry.starts_with("queue_full");
  EXPECT_EQ(told, dropped(a, Drop::kQueueFull));
}

TEST(Stage, LiveGapIsGivenUpAndALateArrivalIsLate) {
  const Network network(2);
  Reader reader(network.open(0), setup("registration"));
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  out.put(sweep_bytes(sweep_header(1, 0, false)));
  out.put(sweep_bytes(sweep_header(1, 2, false)));
  ASSERT_TRUE(reader.wait_for(3));
  out.put(sweep_bytes(sweep_header(1, 1, false)));
  out.put(sweep_bytes(sweep_header(1, 3, false)));
  ASSERT_TRUE(reader.wait_for(4));
  reader.stage->stop();
  EXPECT_THAT(reader.seen.get(), testing::ElementsAre("0", "lost1", "2", "3"));
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.lost, 1U);
  EXPECT_EQ(dropped(a, Drop::kLate), 1U);
}

TEST(Stage, AnotherRunIsRefusedAndTheDriversGoesOn) {
  const Network network(2);
  Reader reader(network.open(0), setup("registration"));
  zenoh::Session source = network.open(1);
  const zenoh::LivelinessToken token = source.declare_liveliness_token(kKeys.run("d", "1"));
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  out.put(sweep_bytes(sweep_header(1, 0, false)));
  for (std::uint64_t run = 2; run < 50; ++run) out.put(sweep_bytes(sweep_header(run, 0, false)));
  out.put(sweep_bytes(sweep_header(1, 900'000, false)));
  out.put(sweep_bytes(sweep_header(1, 1, true)));  // marked as a replay in a live run
  out.put(sweep_bytes(sweep_header(1, 1, false)));
  ASSERT_TRUE(reader.wait_for(2));
  reader.stage->stop();
  EXPECT_THAT(reader.seen.get(), testing::ElementsAre("0", "1"));
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(dropped(a, Drop::kWrongRun), 49U);
  EXPECT_EQ(dropped(a, Drop::kInvalid), 1U);
}

TEST(Stage, OfTwoInstancesTheElderPublishesAndBothSaySo) {
  const Network network(3);
  zenoh::Session listener = network.open(2);
  Watched<std::set<std::string>> publishers;
  const zenoh::Subscriber subscriber =
      listener.declare_subscriber(kKeys.of(Key::kPose), [&](zenoh::Sample&& sample) {
        const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
        const auto name = message_of<msg::MapPose>(bytes.data()).header()->instance()->str();
        publishers.change([&](auto& names) { names.insert(name); });
      });
  const auto publish = [](Stage& stage) {
    Outlet& out = stage.outlet(Key::kPose);
    stage.every(std::chrono::milliseconds(10), [&stage, &out] {
      HeaderFields h = out.header(stage.now_ns(), stage.now_ns());
      h.frame = "map";
      out.publish(h, build(h, MapPoseFields{}));
    });
  };
  auto elder =
      std::make_unique<RunningStage>(network.open(0), setup("integration", "elder"), publish);
  ASSERT_TRUE(publishers.wait([](const auto& names) { return names.contains("elder"); }));
  RunningStage younger(network.open(1), setup("integration", "younger"), publish);
  const auto says = [](RunningStage& stage, const std::string& other) {
    return stage->status().reason.find(other) != std::string::npos;
  };
  while (!says(*elder, "younger") || !says(younger, "elder")) std::this_thread::yield();
  publishers.change([](auto& names) { names.clear(); });
  ASSERT_TRUE(publishers.wait([](const auto& names) { return !names.empty(); }));
  EXPECT_THAT(publishers.get(), testing::ElementsAre("elder"));
  elder.reset();
  ASSERT_TRUE(publishers.wait([](const auto& names) { return names.contains("younger"); }));
  while (says(younger, "elder")) std::this_thread::yield();
}

TEST(Stage, WhoIsSilentTakesNothingAndBeginsWhereTheOtherEnds) {
  const Network network(3);
  auto elder = std::make_unique<Reader>(network.open(0), setup("integration", "elder"));
  Reader younger(network.open(1), setup("integration", "younger"));
  while ((*younger.stage)->status().reason.find("elder") == std::string::npos) {
    std::this_thread::yield();
  }
  zenoh::Session source = network.open(2);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  std::uint64_t sweep = 0;
  const auto put_until = [&](const auto& enough) {
    for (; !enough(); ++sweep) {
      out.put(sweep_bytes(sweep_header(1, sweep, false)));
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  };
  put_until([&] { return elder->seen.get().size() >= 5 && younger.account().not_mine >= 5; });
  EXPECT_THAT(younger.seen.get(), testing::IsEmpty());
  elder.reset();
  put_until([&] { return younger.seen.get().size() >= 5; });
  younger.stage->stop();
  // Each number came once, and in order.
  EXPECT_GE(std::stoull(younger.seen.get().front()), younger.account().not_mine);
  EXPECT_TRUE(younger.account().balanced());
  EXPECT_EQ(younger.account().lost, 0U);
}

TEST(Stage, AHandlerThatThrowsCostsItsMessageOnly) {
  const Network network(2);
  Watched<int> handled;
  RunningStage stage(network.open(0), setup("registration"), [&](Stage& core) {
    core.inlet<msg::Sweep>(Key::kSweep, {}, [&](const Received<msg::Sweep>& sweep) {
      if (sweep.sweep() == 0) throw std::runtime_error("on purpose");
      handled.change([](int& n) { ++n; });
    });
  });
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  out.put(sweep_bytes(sweep_header(1, 0, true)));
  out.put(sweep_bytes(sweep_header(1, 1, true)));
  ASSERT_TRUE(handled.wait([](int n) { return n == 1; }));
  EXPECT_EQ(stage->status().health, ServiceHealth::kDegraded);
  EXPECT_THAT(stage->status().reason, testing::HasSubstr("on purpose"));
  EXPECT_EQ(stage.stop(), kExitOk);
  EXPECT_TRUE(stage->accounts().at(0).balanced());
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

TEST(RunId, IsAFunctionOfCaptureAndConfigurations) {
  // SHA-256 of the empty text, FIPS 180-4's well-known value.
  EXPECT_EQ(sha256_hex(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  const std::uint64_t run = replay_run_id("c", {{"a", "1"}, {"b", "2"}});
  EXPECT_EQ(run, replay_run_id("c", {{"b", "2"}, {"a", "1"}}));
  EXPECT_NE(run, replay_run_id("d", {{"a", "1"}, {"b", "2"}}));
  EXPECT_NE(run, replay_run_id("c", {{"a", "1"}, {"b", "3"}}));
  EXPECT_NE(run, replay_run_id("c", {{"a", "1"}}));
}

TEST(Latencies, PercentilesByNearestRankOverBoundedSamples) {
  Latencies l;
  for (int i = 1; i <= 100; ++i) l.add("x", i);
  const LatencySummary s = l.summaries().at(0);
  EXPECT_EQ(s.count, 100U);
  EXPECT_EQ(s.p50_ms, 50.0);
  EXPECT_EQ(s.p95_ms, 95.0);
  EXPECT_EQ(s.p99_ms, 99.0);
  EXPECT_EQ(s.max_ms, 100.0);
  for (int i = 0; i < 200'000; ++i) l.add("y", i % 1000);
  const LatencySummary y = l.summaries().at(1);
  EXPECT_EQ(y.count, 200'000U);
  EXPECT_NEAR(y.p50_ms, 500.0, 25.0);
  EXPECT_EQ(y.max_ms, 999.0);
}

TEST(Stage, AResultThatIsLostIsToldUntilTheEndAndInTheExitCode) {
  const Network network(1);
  RunningStage stage(network.open(0), setup("mapping"), [](Stage& core) {
    core.lost_output("");
    core.lost_output("out/map.pcd: no space left");
    core.degraded("map file", "");
  });
  while ((*stage).status().health == ServiceHealth::kStarting) std::this_thread::yield();
  EXPECT_EQ(stage->status().reason, "lost output: out/map.pcd: no space left");
  EXPECT_EQ(stage.stop(), kExitIo);
}

}  // namespace
}  // namespace zloam::runtime
