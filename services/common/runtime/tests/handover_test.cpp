// Two instances of a stage on sessions of their own: one hands over, hangs, or is overtaken.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <limits>
#include <map>
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

/// An instance of integration that publishes a pose for every `every`-th odometry, and reports of
/// the others that they wait; while `hold` is set, it hangs in a sweep.
struct Instance {
  Instance(zenoh::Session opened, const std::string& name, std::uint64_t every_sweep = 1)
      : session(std::move(opened)), every(every_sweep) {
    StageSetup s = setup("integration", name);
    s.shared.recovery.standby = true;
    s.start_again = [this] { restarts.change([](int& n) { ++n; }); };
    stage = std::make_unique<StageCore>(std::move(s), session);
    thread = std::thread([this] {
      if (!stage->stand_by()) return;
      wire();
      works.change([](bool& w) { w = true; });
      stage->run();
      ended.change([](bool& e) { e = true; });
    });
  }
  ~Instance() {
    hold.change([](bool& held) { held = false; });
    stage->stop();
    thread.join();
  }
  void wire() {
    stage->on_hand_over([this](bool leaves) {
      left.change([leaves](std::vector<bool>& all) { all.push_back(leaves); });
    });
    Outlet& out = stage->outlet(Key::kPose);
    FlowAck& ack = stage->flow_ack("integration");
    const auto work = [this, &out, &ack](const Received<msg::Odometry>& odometry) {
      hold.wait([](bool held) { return !held; });
      HeaderFields h = out.header(odometry);
      h.frame = "map";
      if (odometry.sweep() % every != 0) return ack.waits(odometry.run());
      out.publish(h, build(h, MapPoseFields{}));
      ack.done_below(odometry.run(), odometry.sweep() + 1);
    };
    stage->inlet<msg::Odometry>(Key::kOdometry, {}, work);
  }

  zenoh::Session session;
  std::uint64_t every;
  std::unique_ptr<StageCore> stage;
  Watched<bool> works, ended, hold;
  Watched<int> restarts;
  Watched<std::vector<bool>> left;
  std::thread thread;
};

/// Publishes odometry and collects the poses received: sweep -> (instance, term).
class Chain {
 public:
  using Heard = std::map<std::uint64_t, std::set<std::pair<std::string, std::uint32_t>>>;

  explicit Chain(zenoh::Session opened) : session_(std::move(opened)) {
    zenoh::PublisherOptions options;
    options.encoding = encoding_of(Key::kOdometry);
    out_.emplace(session_.declare_publisher(kKeys.of(Key::kOdometry), options));
    poses_.emplace(
        session_.declare_subscriber(kKeys.of(Key::kPose), [this](zenoh::Sample&& sample) {
          const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
          const msg::Header& h = *message_of<msg::MapPose>(bytes.data()).header();
          heard.change([&](Heard& all) { all[h.sweep()].insert({h.instance()->str(), h.term()}); });
        }));
    thread_ = std::thread([this] {
      for (std::uint64_t sweep = 0; !done_.load(); ++sweep) {
        HeaderFields h = sweep_header(1, sweep, false);
        h.stamp_ns = wall_ns();
        out_->put(zenoh::Bytes::own(build(h, OdometryFields{})));
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
      }
    });
  }
  ~Chain() {
    done_ = true;
    thread_.join();
  }
  bool hears(const std::string& instance, std::uint32_t term) {
    heard.change([](Heard& all) { all.clear(); });
    return heard.wait([&](const Heard& all) {
      return std::ranges::any_of(all, [&](const auto& each) {
        return each.second.contains({instance, term});
      });
    });
  }
  zenoh::Session& session() { return session_; }

  Watched<Heard> heard;

 private:
  zenoh::Session session_;
  std::optional<zenoh::Publisher> out_;
  std::optional<zenoh::Subscriber> poses_;
  std::atomic<bool> done_{false};
  std::thread thread_;
};

std::string said(zenoh::Session& session, const std::string& arguments) {
  zenoh::GetOptions options;
  options.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
  options.payload = zenoh::Bytes::copy_of(arguments);
  for (const zenoh::Reply& reply : session.get(kKeys.command("integration", "handover"), options)) {
    if (!reply.ok()) continue;
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(reply.sample->payload);
    const auto& r = *flatbuffers::GetRoot<msg::CommandReply>(bytes.data().data());
    return (r.ok() ? "ok: " : "no: ") + r.message()->str();
  }
  return "nobody answered";
}

std::string asked_to_take_over(zenoh::Session& session, const std::string& instance,
                               const std::string& payload = {}) {
  zenoh::GetOptions options;
  options.payload = zenoh::Bytes::copy_of(payload);
  options.timeout = std::chrono::duration_cast<std::chrono::milliseconds>(kPatience);
  for (const zenoh::Reply& reply : session.get(kKeys.takeover("integration", instance), options)) {
    return reply.ok() ? "ok: " + reply.sample->payload.to_string()
                      : "no: " + reply.error.to_string();
  }
  return "nobody answered";
}

/// Asks until the answer is as expected: a token takes a moment to arrive.
bool answers(zenoh::Session& session, const std::string& instance, const std::string& payload,
             const std::string& expected) {
  const auto until = std::chrono::steady_clock::now() + kPatience;
  while (asked_to_take_over(session, instance, payload) != expected) {
    if (std::chrono::steady_clock::now() > until) return false;
  }
  return true;
}

bool becomes_true(const std::function<bool()>& holds) {
  const auto until = std::chrono::steady_clock::now() + kPatience;
  while (!holds()) {
    if (std::chrono::steady_clock::now() > until) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

bool waits(Instance& instance) {
  return becomes_true([&] { return instance.stage->status().reason == "standing by"; });
}

/// Whether it hears that another instance takes precedence, although it hangs in a sweep.
bool becomes_silent(Instance& instance) {
  return becomes_true([&] { return instance.stage->status().figures["silent"] == 1.0; });
}

const auto kYes = [](bool yes) { return yes; };

TEST(HandOver, TheOneThatStandsByGoesOnWithAGreaterTerm) {
  const Network network(3);
  Chain chain(network.open(2));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  EXPECT_THAT(said(chain.session(), "{}"), testing::HasSubstr("no: no other instance"));
  Instance younger(network.open(1), "younger");
  ASSERT_TRUE(waits(younger));
  EXPECT_EQ(said(chain.session(), R"({"to": "nobody"})"),
            "no: no instance nobody of integration stands by; these do: younger");
  EXPECT_THAT(said(chain.session(), R"({"to": "younger"})"),
              testing::AllOf(testing::HasSubstr("ok: younger goes on after sweep "),
                             testing::EndsWith(", term 2")));
  ASSERT_TRUE(chain.hears("younger", 2));
  ASSERT_TRUE(elder.ended.wait(kYes));
  EXPECT_TRUE(elder.stage->begins_again());
  EXPECT_FALSE(younger.stage->begins_again());
  // A signal may come while it ends.
  elder.stage->stop();
  EXPECT_FALSE(elder.stage->begins_again());
}

// Its host has no clock that runs while it is off, or its clock was set back.
TEST(HandOver, WhoComesLaterStandsByThoughItsClockIsBehind) {
  const Network network(2);
  zenoh::Session one = network.open(0), other = network.open(1);
  const auto silent_first = std::make_shared<std::atomic<bool>>(false);
  const auto silent_second = std::make_shared<std::atomic<bool>>(false);
  Singleton first(one, kKeys, "mapping", {1, 1000, "first"}, silent_first);
  first.enter();
  Singleton second(other, kKeys, "mapping", {1, 1, "second"}, silent_second);
  const auto until = std::chrono::steady_clock::now() + kPatience;
  while (!second.elder() && std::chrono::steady_clock::now() < until) second.ask();
  second.enter();
  while (first.others().empty() && std::chrono::steady_clock::now() < until) first.ask();
  EXPECT_EQ(second.elder(), (Seniority{1, 1000, "first"}));
  EXPECT_TRUE(*silent_second);
  EXPECT_THAT(first.juniors(), testing::ElementsAre("second"));
  EXPECT_FALSE(*silent_first);
}

// Asks until the elder has heard of the ghost; each refusal comes at once.
std::string said_of_ghost(zenoh::Session& session) {
  std::string reply;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (reply.find("ghost") == std::string::npos && std::chrono::steady_clock::now() < deadline) {
    reply = said(session, "{}");
  }
  return reply;
}

TEST(HandOver, WhereTheOtherDoesNotAnswerThisOneGoesOn) {
  const Network network(2);
  Chain chain(network.open(1));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  const auto ghost = chain.session().declare_liveliness_token(
      kKeys.active("integration", "ghost", "1", std::to_string(wall_ns())));
  const std::string reply = said_of_ghost(chain.session());
  EXPECT_EQ(reply, "no: ghost does not answer: this instance goes on");
  EXPECT_THAT(elder.left.get(), testing::ElementsAre(true, false));
  EXPECT_TRUE(chain.hears("elder", 1));
}

TEST(HandOver, TheReasonOfOneThatRefusesIsTold) {
  const Network network(2);
  Chain chain(network.open(1));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  const auto refusal = chain.session().declare_queryable(
      kKeys.takeover("integration", "ghost"),
      [](zenoh::Query&& query) { query.reply_error(zenoh::Bytes::copy_of("it leaves")); });
  const auto ghost = chain.session().declare_liveliness_token(
      kKeys.active("integration", "ghost", "1", std::to_string(wall_ns())));
  const std::string reply = said_of_ghost(chain.session());
  EXPECT_EQ(reply, "no: ghost does not take over (it leaves): this instance goes on");
  EXPECT_TRUE(chain.hears("elder", 1));
}

TEST(HandOver, OfOneThatHangsItIsToldWhatToDo) {
  const Network network(2);
  Chain chain(network.open(1));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  Watched<std::vector<zenoh::Query>> held;
  const auto hangs = chain.session().declare_queryable(
      kKeys.takeover("integration", "ghost"), [&held](zenoh::Query&& query) {
        held.change([&](auto& queries) { queries.push_back(std::move(query)); });
      });
  const auto ghost = chain.session().declare_liveliness_token(
      kKeys.active("integration", "ghost", "1", std::to_string(wall_ns())));
  const std::string reply = said_of_ghost(chain.session());
  EXPECT_THAT(reply, testing::StartsWith("no: ghost is there and has not answered within 3 s"));
  EXPECT_THAT(reply, testing::HasSubstr("end its process and start it again"));
  EXPECT_THAT(reply, testing::EndsWith(": this instance goes on"));
  EXPECT_TRUE(chain.hears("elder", 1));
}

TEST(HandOver, OneThatAStrangersTokenSilencesWorksAgainWhenItIsAskedTo) {
  const Network network(2);
  Chain chain(network.open(1));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  EXPECT_EQ(asked_to_take_over(chain.session(), "elder"), "no: this instance works already");
  // Of an equal term, and older.
  const auto ghost =
      chain.session().declare_liveliness_token(kKeys.active("integration", "ghost", "1", "0"));
  EXPECT_TRUE(answers(chain.session(), "elder", "", "ok: 2"));
  EXPECT_TRUE(chain.hears("elder", 2));
}

TEST(HandOver, OneThatStandsByForAStrangersTermWorksWhenItIsAskedTo) {
  const Network network(2);
  Chain chain(network.open(1));
  // Without any stage it would take itself for the first one, and not look for an older instance.
  const auto stage = chain.session().declare_liveliness_token(kKeys.alive("odometry", "another"));
  const auto ghost =
      chain.session().declare_liveliness_token(kKeys.active("integration", "ghost", "1000", "0"));
  Instance own(network.open(0), "own");
  ASSERT_TRUE(waits(own));
  EXPECT_EQ(asked_to_take_over(chain.session(), "own"), "ok: 1001");
  EXPECT_TRUE(chain.hears("own", 1001));
}

TEST(HandOver, ATermThatNoTakeOversCanHaveReachedSilencesNobody) {
  const std::string greatest = std::to_string(std::numeric_limits<std::uint32_t>::max());
  const Network network(2);
  Chain chain(network.open(1));
  const auto before = chain.session().declare_liveliness_token(
      kKeys.active("integration", "before", greatest, "0"));
  Instance own(network.open(0), "own");
  ASSERT_TRUE(chain.hears("own", 1));
  const auto later =
      chain.session().declare_liveliness_token(kKeys.active("integration", "later", greatest, "0"));
  // The same sender's next token has been heard when this one has.
  const auto after =
      chain.session().declare_liveliness_token(kKeys.active("integration", "after", "1", "0"));
  EXPECT_TRUE(answers(chain.session(), "own", "", "ok: 2"));
  EXPECT_FALSE(own.stage->begins_again());
}

TEST(HandOver, OneThatWorkedAndIsSilentIsNoStandbyForAPlannedHandOver) {
  const Network network(2);
  Chain chain(network.open(1));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  const auto ghost =
      chain.session().declare_liveliness_token(kKeys.active("integration", "ghost", "1", "0"));
  EXPECT_TRUE(answers(chain.session(), "elder", "handover", "no: this instance does not stand by"));
}

void hangs_and_is_overtaken(Chain& chain, Instance& elder, Instance& younger) {
  ASSERT_TRUE(waits(younger));
  ASSERT_TRUE(chain.hears("elder", 1));
  elder.hold.change([](bool& held) { held = true; });
  ASSERT_TRUE(chain.hears("younger", 2));
}

TEST(HandOver, OneThatHangsIsOvertakenAndSaysNothingAfterwards) {
  const Network network(3);
  Chain chain(network.open(2));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  Instance younger(network.open(1), "younger");
  ASSERT_NO_FATAL_FAILURE(hangs_and_is_overtaken(chain, elder, younger));
  ASSERT_TRUE(becomes_silent(elder));
  chain.heard.change([](auto& all) { all.clear(); });
  elder.hold.change([](bool& held) { held = false; });
  ASSERT_TRUE(elder.ended.wait(kYes));
  EXPECT_TRUE(elder.stage->begins_again());
  // Not by hears(), which clears what came since the elder continued. Several sweeps, so that what
  // is still in transit has come.
  ASSERT_TRUE(chain.heard.wait([](const auto& all) { return all.size() >= 10; }));
  for (const auto& [sweep, who] : chain.heard.get()) {
    EXPECT_THAT(who, testing::ElementsAre(std::pair<std::string, std::uint32_t>("younger", 2)))
        << sweep;
  }
}

TEST(HandOver, OneThatHangsAndIsToldToStopDoesNotBeginAgain) {
  const Network network(3);
  Chain chain(network.open(2));
  Instance elder(network.open(0), "elder");
  ASSERT_TRUE(chain.hears("elder", 1));
  Instance younger(network.open(1), "younger");
  ASSERT_NO_FATAL_FAILURE(hangs_and_is_overtaken(chain, elder, younger));
  elder.stage->stop();
  Watched<int> looks;
  const auto statuses = chain.session().declare_subscriber(
      kKeys.status("integration", "elder"),
      [&looks](zenoh::Sample&&) { looks.change([](int& n) { ++n; }); });
  // At the sixth look it would.
  EXPECT_TRUE(looks.wait([](int n) { return n >= 8; }));
  EXPECT_EQ(elder.restarts.get(), 0);
}

// Mapping publishes seldom with a great mapping.every, and integration when mapping searches for
// its place in a replay. Here two seconds lie between two poses, and one is a stall.
TEST(HandOver, OneThatPublishesSeldomAndAcknowledgesEachSweepIsNotOvertaken) {
  const Network network(3);
  Chain chain(network.open(2));
  Instance elder(network.open(0), "elder", 100);
  ASSERT_TRUE(chain.hears("elder", 1));
  Instance younger(network.open(1), "younger");
  ASSERT_TRUE(waits(younger));
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(chain.hears("elder", 1));
  EXPECT_EQ(younger.stage->status().reason, "standing by");
  EXPECT_FALSE(elder.stage->begins_again());
}

}  // namespace
}  // namespace zloam::runtime
