// Which run is followed: what a second driver, a forger and a restart can and can't do.

#include "common/runtime/run_gate.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

TEST(RunGate, AnotherRunNeverChangesTheOneWhoseDriverIsThere) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 0));
  for (std::uint64_t forged = 2; forged < 2000; ++forged)
    EXPECT_FALSE(gate.admit(forged, false, 1));
  EXPECT_TRUE(gate.admit(1, false, 2));
  // Silence of the followed run changes nothing either: its sensor may be unplugged for a while.
  EXPECT_FALSE(gate.admit(2, false, 60 * kSecond));
  EXPECT_TRUE(gate.admit(1, false, 61 * kSecond));
}

TEST(RunGate, AForgerWhoIsFirstIsNotFollowed) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_FALSE(gate.admit(9, false, 0));
  EXPECT_TRUE(gate.admit(1, false, 0));
}

TEST(RunGate, ADriverThatComesIsBelievedOverAForgerWhoWasThereBefore) {
  RunGate gate;
  EXPECT_TRUE(gate.admit(9, false, 0));  // nobody has declared anything yet
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 1));
  EXPECT_FALSE(gate.admit(9, false, 2));
}

TEST(RunGate, TwoDriversWithTokensTheFirstStaysAndGoesOnWhenTheOtherIsGone) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 0));
  gate.token("driver/b/run/2", 2, true);
  EXPECT_FALSE(gate.admit(2, false, 1));
  EXPECT_TRUE(gate.admit(1, false, 1));
  gate.token("driver/b/run/2", 2, false);
  EXPECT_TRUE(gate.admit(1, false, 2));
}

TEST(RunGate, ADriverThatIsStartedAgainIsFollowedAtOnce) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 0));
  gate.token("driver/a/run/1", 1, false);
  EXPECT_TRUE(gate.admit(1, false, 1));  // the last of it is still on its way
  gate.token("driver/b/run/2", 2, true);
  EXPECT_TRUE(gate.admit(2, false, 2));
  EXPECT_FALSE(gate.admit(1, false, 3));
  EXPECT_TRUE(gate.follows(2));
}

TEST(RunGate, ADriverThatIsStartedAgainMayBeHeardBeforeItsToken) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 0));
  gate.token("driver/a/run/1", 1, false);
  EXPECT_FALSE(gate.admit(2, false, kGoneSilence_ns - 1));
  EXPECT_TRUE(gate.admit(2, false, kGoneSilence_ns));
  // If run 2 was a forger's, the true driver is followed as soon as its token is there.
  gate.token("driver/b/run/3", 3, true);
  EXPECT_TRUE(gate.admit(3, false, kGoneSilence_ns + 1));
  EXPECT_FALSE(gate.admit(2, false, kGoneSilence_ns + 2));
}

TEST(RunGate, WithoutTokensTheFirstIsFollowedUntilItIsSilent) {
  RunGate gate;
  EXPECT_TRUE(gate.admit(1, false, 0));
  EXPECT_FALSE(gate.admit(2, false, kRunSilence_ns - 1));
  EXPECT_TRUE(gate.admit(1, false, kRunSilence_ns - 1));
  EXPECT_FALSE(gate.admit(2, false, kRunSilence_ns));
  EXPECT_TRUE(gate.admit(2, false, 3 * kRunSilence_ns));
  // A run that was left is not left for good.
  EXPECT_FALSE(gate.admit(1, false, 3 * kRunSilence_ns + 1));
  EXPECT_TRUE(gate.admit(1, false, 5 * kRunSilence_ns));
}

TEST(RunGate, WhetherItIsAReplayIsFixedAtTheFirstMessage) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 0));
  EXPECT_FALSE(gate.admit(1, true, 1));
  EXPECT_TRUE(gate.admit(1, false, 1));
  // If the first message was a forger's, the true run is followed after the silence.
  EXPECT_TRUE(gate.admit(1, true, 1 + kRunSilence_ns));
}

TEST(RunGate, TwoTokensOfOneRunAreTwo) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  gate.token("driver/b/run/1", 1, true);
  gate.token("driver/b/run/1", 1, false);
  EXPECT_TRUE(gate.admit(1, false, 0));
  EXPECT_FALSE(gate.admit(2, false, 0));
}

TEST(RunGate, AFloodOfTokensHidesNobodyWhoIsFollowed) {
  RunGate gate;
  gate.token("driver/a/run/1", 1, true);
  EXPECT_TRUE(gate.admit(1, false, 0));
  for (std::uint64_t n = 2; n < 100'000; ++n)
    gate.token("driver/x/run/" + std::to_string(n), n, true);
  EXPECT_FALSE(gate.admit(2, false, 1));
  EXPECT_TRUE(gate.admit(1, false, 1));
}

}  // namespace
}  // namespace zloam::runtime
