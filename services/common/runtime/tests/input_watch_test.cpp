// When an input counts as silent or as refused, and when either ends.

#include "common/runtime/input_watch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr const char* kKey = "loam/robot/odometry";

/// One input, looked at once a second.
class Watched {
 public:
  Watched() { account_.key = kKey; }
  /// A second with this many good messages and this many dropped ones.
  void second(std::uint64_t good, Drop reason = Drop::kGarbage, std::uint64_t bad = 0,
              bool expected = true) {
    unasked_ += good;
    account_.received += good + bad;
    account_.processed += good;
    account_.dropped[static_cast<std::size_t>(reason)] += bad;
    look(expected);
  }
  /// A second in which this many good messages arrived as answers to requests, and no others.
  void second_on_request(std::uint64_t good) {
    account_.received += good;
    account_.processed += good;
    account_.recovered += good;
    look(true);
  }
  /// A second in which the worker was busy and read nothing of what came.
  void second_unread(std::uint64_t came) {
    account_.received += came;
    account_.queued += came;
    unread_ = true;
    look(true);
    unread_ = false;
  }
  std::string silent() { return found_["silent loam/robot/odometry"]; }
  std::string refused() { return found_["refused loam/robot/odometry"]; }

 private:
  void look(bool expected) {
    now_ns_ += kSecond;
    found_ = watch_.look({{account_, unasked_, unread_, expected}}, now_ns_);
  }

  InputWatch watch_;
  Account account_;
  std::uint64_t unasked_ = 0;
  bool unread_ = false;
  std::int64_t now_ns_ = 5 * kSecond;
  std::map<std::string, std::string> found_;
};

TEST(InputWatch, SilenceIsSaidAndOver) {
  Watched input;
  input.second(0);
  EXPECT_EQ(input.silent(), "");  // nothing has come yet
  for (int i = 0; i < 3; ++i) input.second(10);
  EXPECT_EQ(input.silent(), "");
  input.second(0);
  EXPECT_EQ(input.silent(), "no loam/robot/odometry for 1 s");
  input.second(0);
  EXPECT_EQ(input.silent(), "no loam/robot/odometry for 2 s");
  input.second(1);
  EXPECT_EQ(input.silent(), "");
}

TEST(InputWatch, ASlowInputHasItsOwnPeriod) {
  Watched input;
  for (int i = 0; i < 6; ++i) {  // one in two seconds
    input.second(1);
    EXPECT_EQ(input.silent(), "") << i;
    input.second(0);
    if (i > 1) {
      EXPECT_EQ(input.silent(), "") << i;
    }
  }
  for (int i = 0; i < 6; ++i) input.second(0);
  EXPECT_THAT(input.silent(), HasSubstr("for 7 s"));
}

TEST(InputWatch, WhatIsNotExpectedIsNotMissed) {
  Watched input;
  for (int i = 0; i < 3; ++i) input.second(10);
  for (int i = 0; i < 3; ++i) input.second(0, Drop::kGarbage, 0, false);  // the run has ended
  EXPECT_EQ(input.silent(), "");
  input.second(0);
  EXPECT_EQ(input.silent(), "");
}

TEST(InputWatch, StrangersAreNoSignOfLife) {
  Watched input;
  for (int i = 0; i < 3; ++i) input.second(10);
  input.second(0, Drop::kWrongRun, 100);
  EXPECT_EQ(input.silent(), "no loam/robot/odometry for 1 s");
}

TEST(InputWatch, WhatComesOnRequestOnlyIsTold) {
  Watched input;
  for (int i = 0; i < 3; ++i) input.second(10);
  input.second(0);
  EXPECT_EQ(input.silent(), "no loam/robot/odometry for 1 s");
  for (int i = 0; i < 3; ++i) input.second_on_request(10);
  EXPECT_THAT(input.silent(), HasSubstr("comes only on request for 4 s"));
  input.second(1);
  EXPECT_EQ(input.silent(), "");
}

TEST(InputWatch, AWorkerThatIsBusyMakesNoInputSilent) {
  Watched input;
  for (int i = 0; i < 3; ++i) input.second(10);
  for (int i = 0; i < 3; ++i) {
    input.second_unread(10);
    EXPECT_EQ(input.silent(), "") << i;
  }
  input.second(0);
  EXPECT_EQ(input.silent(), "no loam/robot/odometry for 1 s");
}

TEST(InputWatch, RefusalsAreNamedAndOver) {
  for (const auto& [reason, name] : {std::pair{Drop::kGarbage, "garbage"},
                                     {Drop::kInvalid, "invalid"},
                                     {Drop::kTorn, "torn"},
                                     {Drop::kWrongRun, "wrong_run"}}) {
    Watched input;
    input.second(10);
    input.second(10, reason, 7);
    EXPECT_THAT(
        input.refused(),
        HasSubstr(std::string("7 messages of loam/robot/odometry refused in a second as ") + name));
    EXPECT_EQ(input.silent(), "");
    for (int i = 0; i < 4; ++i) input.second(10);
    EXPECT_NE(input.refused(), "");
    input.second(10);
    EXPECT_EQ(input.refused(), "");
  }
}

TEST(InputWatch, SecondCopiesAreRefusedWhenNothingElseComes) {
  Watched input;
  input.second(10);
  input.second(10, Drop::kDuplicate, 10);  // two replicas at the same sweeps
  EXPECT_EQ(input.refused(), "");
  input.second(0, Drop::kDuplicate, 10);
  EXPECT_THAT(input.refused(), HasSubstr("nothing but second copies"));
}

TEST(InputWatch, DropsForWantOfTimeAreNoRefusal) {
  Watched input;
  input.second(10);
  input.second(5, Drop::kQueueFull, 5);
  EXPECT_EQ(input.refused(), "");
  EXPECT_EQ(input.silent(), "");
}

}  // namespace
}  // namespace zloam::runtime
