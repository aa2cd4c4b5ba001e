#include "common/geometry/fit_record.hpp"

#include <gtest/gtest.h>

namespace zloam {
namespace {

TEST(FitRecord, JudgesNothingByTwoSweeps) {
  FitRecord record;
  record.add(1.0);
  record.add(1.0);
  EXPECT_FALSE(record.usual());
  record.add(1.0);
  EXPECT_EQ(record.usual(), 1.0);
}

TEST(FitRecord, OneOddSweepChangesNothing) {
  FitRecord record;
  for (const double fit : {0.2, 0.2, 0.2, 9.0, 0.2}) record.add(fit);
  EXPECT_EQ(record.usual(), 0.2);
}

TEST(FitRecord, FollowsWhatLasts) {
  FitRecord record;
  for (int i = 0; i < 20; ++i) record.add(0.2);
  for (std::size_t i = 0; i < FitRecord::kRemembered / 2 + 1; ++i) record.add(0.5);
  EXPECT_EQ(record.usual(), 0.5);
}

}  // namespace
}  // namespace zloam
