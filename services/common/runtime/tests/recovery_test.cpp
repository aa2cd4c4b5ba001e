// A chain of three stages in replay: whatever is dropped on the way, the sink sees every sweep
// once, in order, with the same content, and every account balances.

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <set>
#include <thread>

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

constexpr std::uint64_t kSweeps = 60;

/// Large enough to be sent in fragments, and different in each sweep.
PointVector cloud_of(std::uint64_t sweep) {
  PointVector points(4000);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = {static_cast<float>(sweep),
                 static_cast<float>(i),
                 0.0F,
                 1.0F,
                 static_cast<std::uint32_t>(i),
                 3,
                 ReturnType::kStrongest,
                 0};
  }
  return points;
}

/// Publishes the sweeps as the window allows; stops itself when all are finished.
class Source {
 public:
  Source(Stage& stage, std::uint64_t sweeps)
      : stage_(stage),
        out_(stage.outlet(Key::kSweep)),
        window_(stage.flow_window(out_)),
        sweeps_(sweeps) {
    window_.start_replay("capture");
    stage.on_poll([this] { return poll(); });
  }

 private:
  Poll poll() {
    if (!window_.begun()) return Poll::kWait;
    if (next_ == sweeps_) {
      if (window_.finished()) stage_.stop();
      return Poll::kWait;
    }
    if (!window_.may_send(next_)) return Poll::kWait;
    HeaderFields h = out_.header(stage_.now_ns(), stage_.now_ns());
    h.run = window_.run();
    h.sweep = next_;
    h.frame = "lidar";
    h.stamp_ns = static_cast<std::int64_t>(next_) * 100'000'000;
    h.replay = true;
    h.end_of_run = next_ + 1 == sweeps_;
    const PointVector points = cloud_of(next_);
    out_.publish(h, build(h, SweepFields{.points = points, .rings = 16}));
    ++next_;
    return Poll::kAgain;
  }

  Stage& stage_;
  Outlet& out_;
  FlowWindow& window_;
  std::uint64_t sweeps_;
  std::uint64_t next_ = 0;
};

struct Seen {
  std::vector<std::uint64_t> sweeps;
  std::uint64_t wrong_content = 0;
  std::uint64_t traces = 0;
  int ends = 0;
};

void wire_middle(Stage& stage) {
  Outlet& out = stage.outlet(Key::kFeatures);
  stage.inlet<msg::Sweep>(Key::kSweep, {}, [&out](const Received<msg::Sweep>& sweep) {
    const HeaderFields h = out.header(sweep);
    out.publish(h, build(h, FeaturesFields{.rings = 16, .sharp = points_of(sweep->points())}));
  });
}

void wire_sink(Stage& stage, Seen* seen) {
  FlowAck& ack = stage.flow_ack("integration");
  stage.inlet<msg::Features>(
      Key::kFeatures, {}, [&ack, seen](const Received<msg::Features>& features) {
        const std::uint64_t sweep = features.sweep();
        seen->sweeps.push_back(sweep);
        const PointVector expected = cloud_of(sweep);
        const PointSpan points = points_of(features->sharp());
        const bool same = points.size() == expected.size() &&
                          std::memcmp(points.data(), expected.data(), points.size_bytes()) == 0;
        if (!same) ++seen->wrong_content;
        if (features.header().trace()->size() == 2) ++seen->traces;
        ack.done_below(features.run(), sweep + 1);
      });
  stage.on_end_of_run([seen](std::uint64_t) { ++seen->ends; });
}

struct Result {
  Seen seen;
  Account middle, sink;
  int source_code = -1;
};

StageSetup chain_setup(const std::string& stage, std::uint64_t fault_every) {
  StageSetup s = setup(stage, stage + "-1", fault_every);
  s.shared.flow.wait_for = {"registration", "integration"};
  s.shared.flow.sinks = {"integration"};
  return s;
}

/// Waits until no more messages arrive. Second copies may still be in flight when the source has
/// finished; they must be accounted for before the stage stops.
bool settled(StageCore& stage) {
  constexpr int kQuietLooks = 10;
  int quiet = 0;
  std::uint64_t received = 0;
  const auto until = std::chrono::steady_clock::now() + zenoh::test::kPatience;
  while (quiet < kQuietLooks && std::chrono::steady_clock::now() < until) {
    const Account a = stage.accounts().at(0);
    quiet = a.received == received && a.queued + a.in_work == 0 ? quiet + 1 : 0;
    received = a.received;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return quiet == kQuietLooks;
}

Result replay(std::uint64_t sweeps, std::uint64_t fault_every, bool shared_memory = false) {
  const Network network(3, shared_memory);
  Result result;
  RunningStage middle(network.open(1), chain_setup("registration", fault_every), wire_middle);
  RunningStage sink(network.open(2), chain_setup("integration", fault_every),
                    [&](Stage& stage) { wire_sink(stage, &result.seen); });
  std::unique_ptr<Source> source;
  RunningStage driver(network.open(0), chain_setup("driver", fault_every),
                      [&](Stage& stage) { source = std::make_unique<Source>(stage, sweeps); });
  result.source_code = driver.join();
  EXPECT_TRUE(settled(*middle));
  middle.stop();
  EXPECT_TRUE(settled(*sink));
  sink.stop();
  result.middle = middle->accounts().at(0);
  result.sink = sink->accounts().at(0);
  return result;
}

std::vector<std::uint64_t> all(std::uint64_t sweeps) {
  std::vector<std::uint64_t> list(sweeps);
  for (std::uint64_t i = 0; i < sweeps; ++i) list[i] = i;
  return list;
}

void expect_whole(const Result& r, std::uint64_t sweeps) {
  EXPECT_EQ(r.source_code, kExitOk);
  EXPECT_EQ(r.seen.sweeps, all(sweeps));
  EXPECT_EQ(r.seen.wrong_content, 0U);
  EXPECT_EQ(r.seen.traces, sweeps);
  EXPECT_EQ(r.seen.ends, 1);
  for (const Account& a : {r.middle, r.sink}) {
    EXPECT_TRUE(a.balanced()) << a.key;
    EXPECT_EQ(a.processed, sweeps) << a.key;
    EXPECT_EQ(a.lost, 0U) << a.key;
    EXPECT_EQ(a.queued, 0U) << a.key;
    EXPECT_EQ(a.in_work, 0U) << a.key;
  }
}

TEST(Recovery, NothingDroppedNothingRecovered) {
  const Result r = replay(kSweeps, 0);
  expect_whole(r, kSweeps);
}

TEST(Recovery, EverySeventhMessageOfEachKeyDropped) {
  const Result r = replay(kSweeps, 7);
  expect_whole(r, kSweeps);
  EXPECT_GT(r.middle.recovered + r.sink.recovered, 0U);
}

TEST(Recovery, EverySecondMessageDroppedThroughSharedMemory) {
  const Result r = replay(kSweeps, 2, true);
  expect_whole(r, kSweeps);
  EXPECT_GT(r.middle.recovered + r.sink.recovered, 0U);
}

TEST(Recovery, KeysWithoutSweepsAreAskedForBySeq) {
  constexpr std::uint64_t kMessages = 20;
  const Network network(2);
  Watched<std::set<std::uint64_t>> seen;
  InletOptions as_they_come;
  as_they_come.order = Order::kAsTheyCome;
  RunningStage reader(network.open(0), setup("odometry", "o", 3), [&](Stage& stage) {
    stage.inlet<msg::GnssBatch>(
        Key::kGnss, as_they_come, [&seen](const Received<msg::GnssBatch>& fixes) {
          seen.change([&](auto& numbers) { numbers.insert(fixes.header().seq()); });
        });
  });
  RunningStage driver(network.open(1), setup("driver", "d"), [&](Stage& stage) {
    Outlet& out = stage.outlet(Key::kGnss);
    stage.on_poll([&out] {
      if (!out.matching() || out.published() == kMessages) return Poll::kWait;
      HeaderFields header = out.header(1, 1);
      header.run = 1;
      header.replay = true;
      out.publish(header, build_gnss(header, {}));
      return Poll::kAgain;
    });
  });
  EXPECT_TRUE(seen.wait([](const auto& numbers) { return numbers.size() == kMessages; }));
  reader.stop();
  const Account a = reader->accounts().at(0);
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.processed, kMessages);
  EXPECT_EQ(a.recovered, kMessages / 3);
  EXPECT_EQ(a.lost, 0U);
}

// A get of map/tile/** is answered with the whole map, whatever numbers it names.
TEST(Recovery, TilesAreNotAskedForByNumber) {
  const Network network(2);
  InletOptions as_they_come;
  as_they_come.order = Order::kAsTheyCome;
  RunningStage reader(network.open(0), setup("store", "s"), [&](Stage& stage) {
    stage.inlet_at<msg::MapTile>(Key::kMapTile, stage.keys().all_tiles(), as_they_come,
                                 [](const Received<msg::MapTile>&) {});
  });
  zenoh::Session mapping = network.open(1);
  std::atomic<int> asked{0};
  const zenoh::Queryable tiles = mapping.declare_queryable(
      kKeys.all_tiles(), [&asked](zenoh::Query&&) { ++asked; }, false);
  zenoh::PublisherOptions options;
  options.encoding = encoding_of(Key::kMapTile);
  zenoh::Publisher out = mapping.declare_publisher(kKeys.tile("plane", 0, 0, 0), options);
  wait_for_reader(out);
  for (const std::uint64_t seq : {0U, 3U}) {
    HeaderFields h = sweep_header(1, 0, true);
    h.seq = seq;
    out.put(zenoh::Bytes::own(build(h, MapTileFields{.layer = "plane", .edge_m = 1.0})));
  }
  const auto until = std::chrono::steady_clock::now() + kPatience;
  while (reader->accounts().at(0).lost == 0 && std::chrono::steady_clock::now() < until) {
    std::this_thread::yield();
  }
  EXPECT_EQ(reader->accounts().at(0).processed, 2U);
  EXPECT_EQ(reader->accounts().at(0).lost, 2U);
  EXPECT_EQ(asked.load(), 0);
}

TEST(Recovery, TheLastSweepDroppedIsPublishedAgain) {
  // The seventh message is the last one, so no later message shows the gap.
  const Result r = replay(7, 7);
  expect_whole(r, 7);
  EXPECT_GT(r.sink.received, 7U - 1U);
}

}  // namespace
}  // namespace zloam::runtime
