#include "common/runtime/statistics.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

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

}  // namespace
}  // namespace zloam::runtime
