// Changes of configuration while running, over Zenoh: they are commanded, in force from their sweep
// on, refused with a reason, and found by an instance that starts later.

#include "common/runtime/live_config.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/runtime/parameters.hpp"
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
using testing::HasSubstr;
using testing::Not;

constexpr std::uint64_t kRun = 3;
constexpr int kWindow = 2;

using Used = std::vector<std::pair<std::uint64_t, int>>;

/// Takes registration's place and records the value that it used for each sweep.
struct Worker {
  Worker(zenoh::Session session, const std::string& instance,
         const std::vector<std::string>& presets = {}) {
    parameters.add("registration.points", &points, {1, 100}, "points", "how many").live();
    parameters.add("registration.rings", &rings, {1, 100}, "", "how built");
    StageSetup s = setup("registration", instance);
    s.shared.flow.window = kWindow;
    s.presets = presets_of(presets, "registration", {"mapping"}, parameters);
    s.parameters = &parameters;
    stage = std::make_unique<RunningStage>(std::move(session), std::move(s), [this](Stage& core) {
      Outlet& out = core.outlet(Key::kFeatures);
      const auto work = [this, &core, &out](const Received<msg::Sweep>& sweep) {
        core.configure_for(sweep);
        used.change([&](Used& u) { u.emplace_back(sweep.sweep(), points); });
        holds.wait([](bool held) { return !held; });
        const HeaderFields header = out.header(sweep);
        out.publish(header, build(header, FeaturesFields{}));
      };
      core.inlet<msg::Sweep>(Key::kSweep, {}, work);
    });
  }
  bool wait_for(std::size_t count) {
    return used.wait([count](const Used& u) { return u.size() >= count; });
  }
  int points = 10, rings = 16;
  Parameters parameters;
  Watched<Used> used;
  /// while it is set, the worker hangs in its sweep
  Watched<bool> holds;
  std::unique_ptr<RunningStage> stage;
};

struct LiveConfiguration : testing::Test {
  // Publishes a single sweep, so that the tests know which sweeps have arrived.
  void sweep(std::uint64_t n) {
    zenoh::PublisherOptions o;
    o.congestion_control = zenoh::CongestionControl::kBlock;
    o.encoding = encoding_of(Key::kSweep);
    if (!sweeps) sweeps = source.declare_publisher(kKeys.of(Key::kSweep), o);
    while (!sweeps->matching()) std::this_thread::yield();
    sweeps->put(zenoh::Bytes::own(build(sweep_header(kRun, n, replay), SweepFields{})));
  }
  CommandReplyFields set(const std::string& payload) {
    zenoh::GetOptions o;
    o.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
    o.payload = zenoh::Bytes::copy_of(std::string_view(payload));
    const auto replies = source.get(kKeys.command("registration", "set"), o);
    if (replies.size() != 1 || !replies[0].ok()) return {false, "not exactly one reply"};
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(replies[0].sample->payload);
    const auto* reply = flatbuffers::GetRoot<msg::CommandReply>(bytes.data().data());
    return {reply->ok(), reply->message()->str(), reply->results_json()->str()};
  }

  Network network{3};
  zenoh::Session source = network.open(0);
  std::optional<zenoh::Publisher> sweeps;
  bool replay = true;
};

TEST_F(LiveConfiguration, IsInForceFromTwoWindowsAheadOn) {
  Worker worker(network.open(1), "w");
  for (std::uint64_t n = 0; n < 3; ++n) sweep(n);
  ASSERT_TRUE(worker.wait_for(3));
  const auto reply = set(R"({"registration.points": 20})");
  ASSERT_TRUE(reply.ok) << reply.message;
  EXPECT_THAT(reply.message, HasSubstr("no other process"));  // the worker is alone
  const auto results = nlohmann::json::parse(reply.results_json);
  EXPECT_EQ(results["rev"], 1);
  EXPECT_EQ(results["from_sweep"], 2 + 2 * kWindow);
  EXPECT_EQ(results["values"], nlohmann::json({{"registration.points", 20}}));
  for (std::uint64_t n = 3; n < 8; ++n) sweep(n);
  ASSERT_TRUE(worker.wait_for(8));
  for (const auto& [n, points] : worker.used.get()) EXPECT_EQ(points, n < 6 ? 10 : 20) << n;
  EXPECT_EQ((*worker.stage)->status().config_rev, 1U);
  EXPECT_EQ((*worker.stage)->config_rev(kRun, 5), 0U);
  EXPECT_EQ((*worker.stage)->config_rev(kRun, 6), 1U);
}

// Replicas that do not know of each other yet both receive the command.
TEST_F(LiveConfiguration, WhatIsSoAlreadyIsNoNewRevision) {
  Worker worker(network.open(1), "w");
  sweep(0);
  ASSERT_TRUE(worker.wait_for(1));
  const auto first = set("registration.points=20");
  ASSERT_TRUE(first.ok) << first.message;
  sweep(1);
  ASSERT_TRUE(worker.wait_for(2));
  EXPECT_EQ(set("registration.points=20").results_json, first.results_json);
  EXPECT_EQ(nlohmann::json::parse(set("registration.points=30").results_json)["rev"], 2);
}

TEST_F(LiveConfiguration, IsRefusedWithKeyValueAndWhatIsAllowed) {
  Worker worker(network.open(1), "w");
  sweep(0);
  ASSERT_TRUE(worker.wait_for(1));
  const std::vector<std::pair<std::string, std::vector<std::string>>> cases = {
      {"registration.points=many", {"registration.points", "'many'", "1 to 100 points"}},
      {"registration.points=101", {"registration.points", "'101'", "1 to 100 points"}},
      {"registration.pionts=5", {"registration.pionts", "'5'", "unknown", "registration.points"}},
      {"registration.rings=5",
       {"registration.rings", "'5'", "while running", "registration.points"}},
      {"registration.points", {"key=value"}},
      {"", {"key=value"}},
  };
  for (const auto& [payload, words] : cases) {
    const auto reply = set(payload);
    EXPECT_FALSE(reply.ok) << payload;
    for (const std::string& word : words) EXPECT_THAT(reply.message, HasSubstr(word)) << payload;
  }
  sweep(1);
  ASSERT_TRUE(worker.wait_for(2));
  EXPECT_EQ(worker.used.get().back().second, 10);
}

TEST_F(LiveConfiguration, BeforeTheFirstSweepThereIsNoneToChangeAt) {
  Worker worker(network.open(1), "w");
  while (!(*worker.stage)->status().identity.stage.empty()) {
    const auto reply = set("registration.points=5");
    EXPECT_FALSE(reply.ok);
    if (reply.message == "not exactly one reply") continue;  // the link is not up yet
    EXPECT_THAT(reply.message, HasSubstr("no sweep"));
    break;
  }
}

TEST_F(LiveConfiguration, IsFoundByAnInstanceThatComesLater) {
  replay = false;  // a replay would be asked for from its start
  // Another stage keeps it when the one that issued it is gone.
  RunningStage other(network.open(2), setup("mapping"), [](Stage& core) {
    core.inlet<msg::Sweep>(Key::kSweep, {}, [](const Received<msg::Sweep>&) {});
  });
  auto worker = std::make_unique<Worker>(network.open(1), "w");
  const auto until_read = [&](std::uint64_t n, const std::function<bool()>& read) {
    // Publish the sweep repeatedly until both links are up; second copies are dropped.
    for (; !read(); std::this_thread::sleep_for(std::chrono::milliseconds(10))) sweep(n);
  };
  until_read(0,
             [&] { return other->accounts().at(0).processed > 0 && !worker->used.get().empty(); });
  const auto first = set("registration.points=20");
  ASSERT_TRUE(first.ok);
  EXPECT_THAT(first.message, Not(HasSubstr("no other process")));
  ASSERT_TRUE(set("registration.points=30").ok);
  // The answers were sent when the other stage had the revisions, so the worker may end at once.
  worker.reset();
  worker = std::make_unique<Worker>(network.open(1), "again");
  until_read(2 * kWindow, [&] { return !worker->used.get().empty(); });
  EXPECT_EQ(worker->used.get().back().second, 30);
}

TEST_F(LiveConfiguration, TheSameFromTheCommandLineIsTheSame) {
  Worker worker(network.open(1), "w",
                {"2:registration.points=20", "4:registration.points=30", "2:mapping.x=1"});
  for (std::uint64_t n = 0; n < 6; ++n) sweep(n);
  ASSERT_TRUE(worker.wait_for(6));
  EXPECT_EQ(worker.used.get(), (Used{{0, 10}, {1, 10}, {2, 20}, {3, 20}, {4, 30}, {5, 30}}));
}

TEST_F(LiveConfiguration, AChangeNamesAReplayOnlyFromTheNextRunOn) {
  Worker worker(network.open(1), "w");
  sweep(0);
  ASSERT_TRUE(worker.wait_for(1));
  const auto hash = [&] {
    zenoh::GetOptions o;
    o.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
    // The worker's queryable may become known here later than its subscriber to sweeps.
    auto replies = source.get(kKeys.config("registration", "w"), o);
    while (replies.empty()) replies = source.get(kKeys.config("registration", "w"), o);
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(replies.front().sample->payload);
    return message_of<msg::EffectiveConfig>(bytes.data()).result_hash()->str();
  };
  const std::string before = hash();
  ASSERT_TRUE(set("registration.points=20").ok);
  sweep(1);
  ASSERT_TRUE(worker.wait_for(2));
  EXPECT_EQ(hash(), before);
  HeaderFields last = sweep_header(kRun, 2, true);
  last.end_of_run = true;
  sweeps->put(zenoh::Bytes::own(build(last, SweepFields{})));
  while (!(*worker.stage)->status().end_of_run) std::this_thread::yield();
  while (hash() == before) std::this_thread::yield();
}

// A worker that restores a map, or hangs, must not let the memory grow.
TEST_F(LiveConfiguration, ChangesThatWaitForABusyWorkerHaveALimit) {
  Worker worker(network.open(1), "w");
  worker.holds.change([](bool& held) { held = true; });
  sweep(0);
  ASSERT_TRUE(worker.wait_for(1));
  zenoh::GetOptions o;
  o.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
  o.payload = zenoh::Bytes::copy_of(std::string_view("registration.points=20"));
  // Shared with the callbacks, which may outlive this test.
  const auto refused = std::make_shared<Watched<int>>();
  for (int i = 0; i < 2000; ++i) {
    source.get(
        kKeys.command("registration", "set"),
        [refused](zenoh::Reply&& reply) {
          if (!reply.ok()) return;
          const zenoh::AlignedBytes bytes = zenoh::view_aligned(reply.sample->payload);
          const auto* r = flatbuffers::GetRoot<msg::CommandReply>(bytes.data().data());
          const bool is_busy =
              !r->ok() && r->message()->str().find("too many") != std::string::npos;
          if (is_busy) refused->change([](int& n) { ++n; });
        },
        [] {}, o);
  }
  EXPECT_TRUE(refused->wait([](int n) { return n > 0; }));
  worker.holds.change([](bool& held) { held = false; });
  sweep(1);
  ASSERT_TRUE(worker.wait_for(2));
  EXPECT_TRUE(set("registration.points=30").ok);
}

/// Takes odometry's place: takes the features that agree with registration's revision in force.
struct Reader {
  explicit Reader(zenoh::Session session)
      : stage(std::move(session), setup("odometry"), [this](Stage& core) {
          InletOptions options;
          options.replicas = true;
          options.admit = [&core](const Message& m) {
            return core.revision_agrees("registration", *m.header);
          };
          core.inlet<msg::Features>(
              Key::kFeatures, options, [this](const Received<msg::Features>& features) {
                taken.change([&](Sweeps& all) { all.push_back(features.sweep()); });
              });
        }) {}
  bool wait_for(std::size_t count) {
    return taken.wait([count](const Sweeps& all) { return all.size() >= count; });
  }
  std::uint64_t invalid() {
    return stage->accounts().at(0).dropped[static_cast<std::size_t>(Drop::kInvalid)];
  }

  using Sweeps = std::vector<std::uint64_t>;
  // Before the stage, whose worker uses it.
  Watched<Sweeps> taken;
  RunningStage stage;
};

struct Revisions : LiveConfiguration {
  Revisions() {
    options.encoding = encoding_of(Key::kConfigRevision);
    zenoh::PublisherOptions o;
    o.congestion_control = zenoh::CongestionControl::kBlock;
    o.encoding = encoding_of(Key::kFeatures);
    out = source.declare_publisher(kKeys.of(Key::kFeatures), o);
    while (!out->matching()) std::this_thread::yield();
  }
  void features(std::uint64_t n, std::uint32_t rev) {
    HeaderFields h = sweep_header(kRun, n, true);
    h.config_rev = rev;
    out->put(zenoh::Bytes::own(build(h, FeaturesFields{})));
  }
  /// Publishes the sweep again and again until `count` have been taken: it was refused before, so
  /// it is not a second copy.
  bool is_taken(std::uint64_t n, std::uint32_t rev, std::size_t count) {
    const auto until = std::chrono::steady_clock::now() + kPatience;
    while (reader.taken.get().size() < count && std::chrono::steady_clock::now() < until) {
      features(n, rev);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return reader.taken.get().size() >= count;
  }
  /// Another process, which keeps the revision.
  zenoh::Queryable keeper() {
    return source.declare_queryable(
        kKeys.config_revision("*"),
        [this](zenoh::Query&& query) {
          query.reply(kKeys.config_revision("registration"), revision, options.encoding);
        },
        false);
  }

  Reader reader{network.open(1)};
  zenoh::PublisherOptions options;
  std::optional<zenoh::Publisher> out;
  zenoh::Bytes revision = [] {
    const Buffer buffer = build(ConfigRevisionFields{
        .stage = "registration", .rev = 1, .run = kRun, .from_sweep = 1, .by = "x"});
    return zenoh::Bytes::copy_of(std::span(buffer.data(), buffer.size()));
  }();
};

TEST_F(Revisions, WhatWasMadeWithAnotherRevisionIsDroppedAndStaysMissing) {
  features(0, 0);
  ASSERT_TRUE(reader.wait_for(1));
  features(1, 1);  // made with an unknown revision
  while (reader.invalid() < 1) std::this_thread::yield();
  // A put alone changes nothing: no process answers with this revision.
  source.put(kKeys.config_revision("registration"), revision, options);
  features(1, 1);
  while (reader.invalid() < 2) std::this_thread::yield();
  EXPECT_EQ(reader.taken.get().size(), 1U);
  const zenoh::Queryable kept = keeper();
  // Once the revision is in force, the same sweep is accepted.
  ASSERT_TRUE(is_taken(1, 1, 2));
  const std::uint64_t before = reader.invalid();
  features(2, 0);  // made with a revision that is no longer in force
  while (reader.invalid() == before) std::this_thread::yield();
  features(2, 1);
  ASSERT_TRUE(reader.wait_for(3));
  reader.stage.stop();
  EXPECT_EQ(reader.taken.get(), (Reader::Sweeps{0, 1, 2}));
  EXPECT_TRUE(reader.stage->accounts().at(0).balanced());
}

TEST_F(Revisions, ALinkThatBreaksThreeTimesDoesNotWithdrawOneForGood) {
  features(0, 0);
  ASSERT_TRUE(reader.wait_for(1));
  const zenoh::Queryable kept = keeper();
  ASSERT_TRUE(is_taken(1, 1, 2));
  for (int i = 0; i < 3; ++i) {
    const auto token = source.declare_liveliness_token(kKeys.alive("registration", "x"));
  }
  // It has been withdrawn: three lives in a row were short.
  ASSERT_TRUE(is_taken(2, 0, 3));
  // The stage lives and keeps its revision.
  ASSERT_TRUE(is_taken(3, 1, 4));
}

}  // namespace
}  // namespace zloam::runtime
