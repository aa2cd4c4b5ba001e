// A killed publisher that restarts finds its last messages with its readers.

#include "common/runtime/recall.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "common/runtime/tests/support.hpp"

namespace zloam::runtime {
namespace {

using test::Network;
using test::RunningStage;
using test::setup;
using test::sweep_header;
using test::Watched;

// Tries are 200 ms apart: together more time than connecting takes.
constexpr int kTries = 100;
constexpr std::chrono::milliseconds kPatience{20'000};

OdometryFields pose_of_sweep(std::uint64_t sweep) {
  OdometryFields fields;
  fields.instant_ns = static_cast<std::int64_t>(sweep) * 100'000'000;
  fields.T_odom_base.translation().x() = static_cast<double>(sweep);
  return fields;
}

std::vector<std::uint64_t> sweeps_of(const std::vector<Received<msg::Odometry>>& messages) {
  std::vector<std::uint64_t> sweeps;
  for (const auto& message : messages) sweeps.push_back(message.sweep());
  return sweeps;
}

/// Of its health, once it works.
std::string reason_of(RunningStage& stage) {
  while (stage->status().health == ServiceHealth::kStarting) std::this_thread::yield();
  return stage->status().reason;
}

class Recall : public ::testing::Test {
 protected:
  // Runs a publisher of sweeps 0 to 4, which ends when all have been read.
  void publish_and_go() {
    RunningStage publisher(network_.open(1), setup("odometry", "killed"), [](Stage& stage) {
      Outlet& out = stage.outlet(Key::kOdometry);
      stage.on_poll([&out, next = std::uint64_t{0}]() mutable {
        if (next == 5 || !out.matching()) return Poll::kWait;
        const HeaderFields header = sweep_header(7, next, true);
        out.publish(header, build(header, pose_of_sweep(next)));
        ++next;
        return Poll::kAgain;
      });
    });
    ASSERT_TRUE(read_.wait([](int n) { return n >= 5; }));
  }

  static void keep(Stage& stage, Watched<int>& read, std::size_t messages) {
    InletOptions options;
    options.sweeps = SweepSet::kPublisherDecides;
    options.keep = messages;
    stage.inlet<msg::Odometry>(Key::kOdometry, options, [&read](const Received<msg::Odometry>&) {
      read.change([](int& n) { ++n; });
    });
  }

  Network network_{3};
  Watched<int> read_;
};

TEST_F(Recall, TheReaderKeepsTheNewest) {
  RunningStage reader(network_.open(0), setup("integration"),
                      [this](Stage& stage) { keep(stage, read_, 3); });
  publish_and_go();
  std::vector<Received<msg::Odometry>> found;
  RunningStage again(network_.open(2), setup("odometry", "again"), [&found](Stage& stage) {
    found = recall<msg::Odometry>(stage, Key::kOdometry, kKept, kTries);
  });
  EXPECT_EQ(sweeps_of(found), (std::vector<std::uint64_t>{2, 3, 4}));
  for (const auto& message : found) {
    EXPECT_EQ(message.run(), 7U);
    EXPECT_EQ(message.header().instance()->str(), "d");
    EXPECT_EQ(pose_of(message->pose_odom_base()).translation().x(),
              static_cast<double>(message.sweep()));
  }
}

TEST_F(Recall, WhoKeepsNothingAnswersNothing) {
  RunningStage reader(network_.open(0), setup("integration"),
                      [this](Stage& stage) { keep(stage, read_, 0); });
  publish_and_go();
  bool there = false;
  bool none = false;
  RunningStage again(network_.open(2), setup("odometry", "again"), [&](Stage& stage) {
    there = wait_for_links([&] { return is_there(stage, "integration"); }, kPatience);
    none = recall<msg::Odometry>(stage, Key::kOdometry, kKept, 3).empty();
  });
  EXPECT_TRUE(there) << "whoever is not linked yet has no answer either";
  EXPECT_TRUE(none);
}

// A store whose disk fails behind the first of its answers.
TEST_F(Recall, AMapOfWhichOnlyAPartComesIsToldAndUsed) {
  zenoh::Session store = network_.open(0);
  const std::string key = test::kKeys.of(Key::kOdometry);
  const auto queryable = store.declare_queryable(key, [&key](zenoh::Query&& query) {
    query.reply(key, zenoh::Bytes::own(build(sweep_header(7, 3, true), pose_of_sweep(3))),
                encoding_of(Key::kOdometry));
    query.reply_error(zenoh::Bytes::copy_of("the disk fails"));
  });
  std::vector<Received<msg::Odometry>> found;
  RunningStage reader(network_.open(1), setup("mapping"), [&](Stage& stage) {
    found = recall_at<msg::Odometry>(stage, key, kTries, false);
  });
  EXPECT_EQ(sweeps_of(found), std::vector<std::uint64_t>{3});
  const std::string reason = reason_of(reader);
  EXPECT_NE(reason.find(key), std::string::npos) << reason;
  EXPECT_NE(reason.find("the disk fails"), std::string::npos) << reason;
}

// Its first answer is short, and then the store is too busy for any.
TEST_F(Recall, WhatCameFirstIsKeptWhenNothingComesAgain) {
  zenoh::Session store = network_.open(0);
  const std::string key = test::kKeys.of(Key::kOdometry);
  const auto asked = std::make_shared<std::atomic<int>>(0);
  const auto queryable = store.declare_queryable(key, [key, asked](zenoh::Query&& query) {
    if (asked->fetch_add(1) == 0) {
      query.reply(key, zenoh::Bytes::own(build(sweep_header(7, 3, true), pose_of_sweep(3))),
                  encoding_of(Key::kOdometry));
    }
    query.reply_error(zenoh::Bytes::copy_of("busy"));
  });
  std::vector<Received<msg::Odometry>> found;
  RunningStage reader(network_.open(1), setup("mapping"), [&](Stage& stage) {
    found = recall_at<msg::Odometry>(stage, key, kTries, false);
  });
  EXPECT_EQ(sweeps_of(found), std::vector<std::uint64_t>{3});
  EXPECT_NE(reason_of(reader).find("busy"), std::string::npos);
}

// A store that compacts: without its answer a new map would take the place of the stored one.
TEST_F(Recall, AStoreThatIsBusyIsAskedAgain) {
  zenoh::Session store = network_.open(0);
  const std::string key = test::kKeys.of(Key::kOdometry);
  // The first query stays unanswered while its owner is busy.
  const auto waiting = std::make_shared<Watched<std::vector<std::shared_ptr<zenoh::Query>>>>();
  const auto queryable = store.declare_queryable(key, [key, waiting](zenoh::Query&& query) {
    waiting->change([&](auto& all) {
      all.push_back(std::make_shared<zenoh::Query>(std::move(query)));
      if (all.size() < 2) return;
      all.back()->reply(key, zenoh::Bytes::own(build(sweep_header(7, 3, true), pose_of_sweep(3))),
                        encoding_of(Key::kOdometry));
      all.clear();
    });
  });
  const auto token = store.declare_liveliness_token(test::kKeys.alive("store", "s"));
  std::vector<Received<msg::Odometry>> found;
  RunningStage reader(network_.open(1), setup("mapping"), [&](Stage& stage) {
    wait_for_links([&] { return is_there(stage, "store"); }, kPatience);
    found = recall_from<msg::Odometry>(stage, key, 1, true, kStore);
  });
  EXPECT_EQ(sweeps_of(found), std::vector<std::uint64_t>{3});
}

TEST_F(Recall, AStageIsThereOnceItCanBeAsked) {
  RunningStage reader(network_.open(0), setup("integration"),
                      [this](Stage& stage) { keep(stage, read_, 3); });
  bool there = false;
  bool absent = false;
  RunningStage asks(network_.open(1), setup("odometry"), [&](Stage& stage) {
    there = wait_for_links([&] { return is_there(stage, "integration"); }, kPatience);
    absent =
        !wait_for_links([&] { return is_there(stage, "store"); }, std::chrono::milliseconds(0));
  });
  EXPECT_TRUE(there);
  EXPECT_TRUE(absent);
}

TEST(GoesOn, OnlyLiveAndForAShortTime) {
  constexpr std::int64_t kLast_ns = 50'000'000'000;
  const auto goes = [](std::int64_t stamp_ns, bool replay) {
    HeaderFields fields = sweep_header(8, 0, replay);
    fields.stamp_ns = stamp_ns;
    const OdometryFields pose = pose_of_sweep(0);
    const Buffer buffer = build(fields, pose);
    const std::span<const std::uint8_t> bytes(buffer.data(), buffer.size());
    return goes_on(*message_of<msg::Odometry>(bytes).header(), kLast_ns);
  };
  EXPECT_TRUE(goes(kLast_ns + 900'000'000, false));
  EXPECT_TRUE(goes(kLast_ns - 100'000'000, false));
  EXPECT_FALSE(goes(kLast_ns + 1'100'000'000, false));
  EXPECT_FALSE(goes(kLast_ns - 5'000'000'000, false));
  EXPECT_FALSE(goes(kLast_ns + 100'000'000, true));
}

}  // namespace
}  // namespace zloam::runtime
