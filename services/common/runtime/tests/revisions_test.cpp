// Which revision is in force at which sweep: this depends on the known revisions and runs only, not
// on the order in which they arrived.

#include "common/runtime/revisions.hpp"

#include <gtest/gtest.h>

#include "common/runtime/short_lives.hpp"

namespace zloam::runtime {
namespace {

constexpr std::uint64_t kRun = 7, kNextRun = 8;
constexpr std::int64_t kSecond = 1'000'000'000;

Revision revision(std::uint32_t rev, std::uint64_t from, std::uint64_t run = kRun,
                  const std::string& by = "a") {
  Revision r;
  r.stage = "odometry";
  r.rev = rev;
  r.run = run;
  r.from_sweep = from;
  r.by = by;
  return r;
}

TEST(RevisionSchedule, NothingChangedIsRevisionZero) {
  RevisionSchedule schedule;
  EXPECT_EQ(schedule.rev_at(kRun, 0), 0U);
  schedule.begin_run(kRun);
  EXPECT_EQ(schedule.rev_at(kRun, 1000), 0U);
  EXPECT_EQ(schedule.in_force(kRun, 1000), nullptr);
}

TEST(RevisionSchedule, IsInForceFromItsSweepOn) {
  RevisionSchedule schedule;
  schedule.begin_run(kRun);
  EXPECT_TRUE(schedule.add(revision(1, 30)));
  EXPECT_TRUE(schedule.add(revision(2, 50)));
  EXPECT_EQ(schedule.rev_at(kRun, 29), 0U);
  EXPECT_EQ(schedule.rev_at(kRun, 30), 1U);
  EXPECT_EQ(schedule.rev_at(kRun, 49), 1U);
  EXPECT_EQ(schedule.rev_at(kRun, 50), 2U);
}

TEST(RevisionSchedule, OfTwoFromOneSweepTheLaterCounts) {
  RevisionSchedule schedule;
  schedule.begin_run(kRun);
  schedule.add(revision(1, 30));
  schedule.add(revision(2, 30));
  EXPECT_EQ(schedule.rev_at(kRun, 29), 0U);
  EXPECT_EQ(schedule.rev_at(kRun, 30), 2U);
}

TEST(RevisionSchedule, TheOrderOfHearingDoesNotMatter) {
  RevisionSchedule schedule;
  EXPECT_TRUE(schedule.add(revision(2, 50)));
  EXPECT_TRUE(schedule.add(revision(1, 30)));
  EXPECT_FALSE(schedule.add(revision(2, 50)));
  schedule.begin_run(kRun);
  EXPECT_EQ(schedule.rev_at(kRun, 40), 1U);
  EXPECT_EQ(schedule.rev_at(kRun, 60), 2U);
  EXPECT_EQ(schedule.all().size(), 2U);
}

TEST(RevisionSchedule, ANewRunHasWhatWasChangedBeforeFromItsFirstSweepOn) {
  RevisionSchedule schedule;
  schedule.begin_run(kRun);
  schedule.add(revision(1, 30));
  EXPECT_EQ(schedule.rev_at(kNextRun, 0), 1U);
  schedule.begin_run(kNextRun);
  EXPECT_EQ(schedule.rev_at(kNextRun, 0), 1U);
  schedule.add(revision(2, 16, kNextRun));
  EXPECT_EQ(schedule.rev_at(kNextRun, 15), 1U);
  EXPECT_EQ(schedule.rev_at(kNextRun, 16), 2U);
}

TEST(RevisionSchedule, WhatIsSaidOfARunToComeChangesNothingInThisOne) {
  RevisionSchedule schedule;
  schedule.begin_run(kRun);
  schedule.add(revision(1, 16, kNextRun));
  EXPECT_EQ(schedule.rev_at(kRun, 500), 0U);
  schedule.begin_run(kNextRun);
  EXPECT_EQ(schedule.rev_at(kNextRun, 15), 0U);
  EXPECT_EQ(schedule.rev_at(kNextRun, 16), 1U);
}

TEST(RevisionSchedule, WithoutARunItIsOfTheOneUnderWayOrToCome) {
  RevisionSchedule before;
  before.add(revision(1, 30, 0));
  EXPECT_EQ(before.rev_at(kRun, 29), 0U);
  EXPECT_EQ(before.rev_at(kRun, 30), 1U);
  before.begin_run(kRun);
  RevisionSchedule within;
  within.begin_run(kRun);
  within.add(revision(1, 30, 0));
  for (RevisionSchedule* schedule : {&before, &within}) {
    EXPECT_EQ(schedule->rev_at(kRun, 29), 0U);
    EXPECT_EQ(schedule->rev_at(kRun, 30), 1U);
    schedule->begin_run(kNextRun);
    EXPECT_EQ(schedule->rev_at(kNextRun, 0), 1U);
  }
}

TEST(RevisionSchedule, OneNumberOfTwoInstancesIsTheGreatersEverywhere) {
  RevisionSchedule one, other;
  one.add(revision(1, 30, kRun, "a"));
  EXPECT_TRUE(one.add(revision(1, 40, kRun, "b")));
  other.add(revision(1, 40, kRun, "b"));
  EXPECT_FALSE(other.add(revision(1, 30, kRun, "a")));
  EXPECT_EQ(one.newest()->from_sweep, 40U);
  EXPECT_EQ(other.newest()->from_sweep, 40U);
}

TEST(Schedule, WhatIsWithdrawnNeverWas) {
  RevisionSchedule s;
  s.begin_run(1);
  Revision first, second;
  first.rev = 1, first.run = 1, first.from_sweep = 10, first.by = "a";
  second.rev = 2, second.run = 1, second.from_sweep = 20, second.by = "a";
  EXPECT_TRUE(s.add(first));
  EXPECT_TRUE(s.add(second));
  EXPECT_EQ(s.rev_at(1, 30), 2U);
  s.withdraw(2, 0);
  EXPECT_EQ(s.rev_at(1, 30), 1U);
  EXPECT_TRUE(s.is_withdrawn(second, 9 * kSecond));
  EXPECT_FALSE(s.is_withdrawn(first, 9 * kSecond));
  Revision again = second;
  again.at_ns = 5;  // issued by an instance started later under the same name
  EXPECT_FALSE(s.is_withdrawn(again, 0));
  again = second;
  again.by = "b";  // issued by an instance started later
  EXPECT_FALSE(s.is_withdrawn(again, 0));
}

// Links broke: the stage lives, and still answers with the revision.
TEST(Schedule, WhatIsStillKeptLongAfterItWasWithdrawnIsTakenBack) {
  RevisionSchedule s;
  s.begin_run(kRun);
  const Revision kept = revision(1, 30);
  for (const std::int64_t now : {0 * kSecond, 100 * kSecond}) {
    EXPECT_FALSE(s.is_withdrawn(kept, now));
    EXPECT_TRUE(s.add(kept));
    s.withdraw(1, now);
    EXPECT_TRUE(s.is_withdrawn(kept, now + 10 * kSecond - 1));
    EXPECT_FALSE(s.is_withdrawn(kept, now + 10 * kSecond));
  }
}

TEST(ShortLives, TheThirdShortLifeInARowWithARevisionIsEnough) {
  ShortLives lives;
  std::int64_t now = 0;
  const auto life = [&](std::int64_t seconds, std::uint32_t rev) {
    const std::string key = "alive" + std::to_string(now);
    lives.came(key, now);
    now += seconds * kSecond;
    return lives.went(key, "registration", rev, now);
  };
  EXPECT_FALSE(life(100, 5));
  EXPECT_FALSE(life(1, 5));
  EXPECT_FALSE(life(2, 5));
  EXPECT_TRUE(life(1, 5));
  EXPECT_FALSE(life(1, 5));  // said once
  // A long life, another revision, none at all.
  EXPECT_FALSE(life(1, 6));
  EXPECT_FALSE(life(1, 6));
  EXPECT_FALSE(life(60, 6));
  EXPECT_FALSE(life(1, 6));
  EXPECT_FALSE(life(1, 6));
  EXPECT_FALSE(life(1, 7));
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(life(1, 0));
}

TEST(ShortLives, ReplicasThatALinkTakesAwayTogetherAreOneLife) {
  ShortLives lives;
  const auto phase_of_the_link = [&](std::int64_t from) {
    bool is_enough = false;
    for (const char* key : {"a", "b", "c"}) lives.came(key, from * kSecond);
    for (const char* key : {"a", "b", "c"}) {
      is_enough |= lives.went(key, "registration", 1, (from + 1) * kSecond);
    }
    return is_enough;
  };
  EXPECT_FALSE(phase_of_the_link(0));
  EXPECT_FALSE(phase_of_the_link(10));
  // A link that comes and goes like this is still taken for a stage that dies; what its other side
  // keeps is taken back (RevisionSchedule::is_withdrawn).
  EXPECT_TRUE(phase_of_the_link(20));
}

TEST(ShortLives, AStageThatGoesOnDyingIsReportedAgain) {
  ShortLives lives;
  int reports = 0;
  for (std::int64_t now = 0; now < 6 * kSecond; now += kSecond) {
    lives.came("a", now);
    if (lives.went("a", "registration", 1, now + kSecond)) ++reports;
  }
  EXPECT_EQ(reports, 2);
}

}  // namespace
}  // namespace zloam::runtime
