// Which of several instances is active: seniority, progress as a standby sees it, refused terms.

#include <gmock/gmock.h>

#include <algorithm>
#include <array>

#include "common/runtime/progress_watch.hpp"
#include "common/runtime/singleton.hpp"
#include "common/runtime/term_fence.hpp"

namespace zloam::runtime {
namespace {

constexpr std::int64_t kMilli_ns = 1'000'000;
constexpr std::int64_t kStall_ns = 1000 * kMilli_ns;

TEST(Seniority, IsReadFromAToken) {
  const auto found = seniority_of("loam/r/service/mapping/two/active/7/1234");
  ASSERT_TRUE(found.has_value());
  EXPECT_EQ(*found, (Seniority{7, 1234, "two"}));
  for (const char* wrong :
       {"loam/r/service/mapping/two/active/1234", "loam/r/service/mapping/two/alive",
        "loam/r/service/mapping/two/active/7/", "loam/r/service/mapping/two/active//1",
        "loam/r/service/mapping/two/active/-1/5", "loam/r/service/mapping/two/active/99999999999/5",
        "/active/1/2", ""}) {
    EXPECT_FALSE(seniority_of(wrong).has_value()) << wrong;
  }
}

TEST(Seniority, AGreaterTermGoesBeforeAnEarlierStart) {
  std::array all = {Seniority{1, 5, "a"}, Seniority{2, 9, "b"}, Seniority{2, 9, "a"},
                    Seniority{1, 4, "z"}, Seniority{2, 8, "c"}};
  std::sort(all.begin(), all.end());
  std::string order;
  for (const Seniority& each : all) order += each.instance;
  EXPECT_EQ(order, "cabza");
}

TEST(ProgressWatch, SweepsOfWhichNothingComesAreAStall) {
  ProgressWatch watch(kStall_ns);
  watch.output();
  std::int64_t now = 0;
  for (int i = 0; i < 20; ++i, now += 100 * kMilli_ns) {
    watch.input(now);
    EXPECT_EQ(watch.stalls(now), now >= kStall_ns) << now;
  }
  watch.output();
  EXPECT_FALSE(watch.stalls(now));
}

TEST(ProgressWatch, ASensorThatPausedIsNoStall) {
  ProgressWatch watch(kStall_ns);
  watch.output();
  EXPECT_FALSE(watch.stalls(60 * kStall_ns));
  // The time to process the first sweeps counts from their arrival, not from the last output.
  for (int i = 0; i < 5; ++i) watch.input(60 * kStall_ns + i * 100 * kMilli_ns);
  EXPECT_FALSE(watch.stalls(60 * kStall_ns + 400 * kMilli_ns));
  EXPECT_TRUE(watch.stalls(61 * kStall_ns));
}

TEST(ProgressWatch, OneOrTwoSweepsMayBeLost) {
  ProgressWatch watch(kStall_ns);
  watch.output();
  watch.input(0);
  watch.input(1);
  EXPECT_FALSE(watch.stalls(100 * kStall_ns));
}

TEST(ProgressWatch, WhoHasJustBegunIsGivenTimeToReadAMap) {
  ProgressWatch watch(kStall_ns);
  watch.output();
  watch.begin();
  for (int i = 0; i < 400; ++i) watch.input(i * 100 * kMilli_ns);
  EXPECT_FALSE(watch.stalls(29 * kStall_ns));
  EXPECT_TRUE(watch.stalls(30 * kStall_ns));
}

TEST(TermFence, RefusesALesserTermAsLongAsTheGreaterIsHeard) {
  constexpr std::uint64_t kRun = 5;
  TermFence fence;
  EXPECT_FALSE(fence.refuses(kRun, 0, 0));
  fence.took(kRun, 1, 0);
  fence.took(kRun, 2, 10);
  EXPECT_TRUE(fence.refuses(kRun, 1, 20));
  EXPECT_FALSE(fence.refuses(kRun, 2, 20));
  EXPECT_FALSE(fence.refuses(kRun, 3, 20));
  EXPECT_FALSE(fence.refuses(kRun + 1, 1, 20));
  EXPECT_TRUE(fence.refuses(kRun, 1, 10 + 2 * kStall_ns - 1));
  EXPECT_FALSE(fence.refuses(kRun, 1, 10 + 2 * kStall_ns));
  // The term of an accepted message counts from then on, so a forged greater term is forgotten.
  fence.took(kRun, 1, 10 + 2 * kStall_ns);
  EXPECT_FALSE(fence.refuses(kRun, 1, 20 + 2 * kStall_ns));
}

}  // namespace
}  // namespace zloam::runtime
