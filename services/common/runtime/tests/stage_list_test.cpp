// The list of stages agrees with the key table.

#include "common/runtime/stage_list.hpp"

#include <gmock/gmock.h>

#include "common/messages/keys.hpp"

namespace zloam::runtime {
namespace {

using testing::AnyOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

const KeyRow* row_of(const std::string& pattern) {
  for (const KeyRow& row : key_table()) {
    if (row.pattern == pattern) return &row;
  }
  return nullptr;
}

TEST(StageList, WhatIsReadAndWrittenIsInTheKeyTable) {
  for (const StageRow& stage : stage_list()) {
    for (const std::string& pattern : stage.reads) {
      EXPECT_NE(row_of(pattern), nullptr) << stage.name << " reads " << pattern;
    }
    for (const std::string& pattern : stage.writes) {
      const KeyRow* row = row_of(pattern);
      ASSERT_NE(row, nullptr) << stage.name << " writes " << pattern;
      const std::string publishers(row->publisher);
      EXPECT_THAT(publishers, AnyOf(HasSubstr(stage.name), "any")) << pattern;
    }
  }
}

TEST(StageList, EachKeyOfAStageHasItAsItsWriter) {
  for (const KeyRow& row : key_table()) {
    const std::string publishers(row.publisher);
    if (row.pattern.starts_with("service/") || row.pattern.starts_with("config/") ||
        row.pattern.starts_with("command/") || row.pattern.starts_with("path/")) {
      continue;  // published by every stage, or only answered
    }
    for (const StageRow& stage : stage_list()) {
      if (publishers.find(stage.name) == std::string::npos) continue;
      EXPECT_THAT(stage.writes, testing::Contains(std::string(row.pattern))) << stage.name;
    }
  }
}

TEST(StageList, AKeyOfTheChainHasItsReaders) {
  EXPECT_THAT(readers_of(Key::kOdometryFeatures), ElementsAre("mapping"));
  EXPECT_THAT(readers_of(Key::kMapCorrection), ElementsAre("integration"));
  EXPECT_THAT(readers_of(Key::kPose), IsEmpty());
}

TEST(StageList, AReplayWaitsForAllThatReadAndIsPacedByThoseAtTheEnd) {
  EXPECT_THAT(stages_behind_the_source(),
              ElementsAre("registration", "odometry", "mapping", "integration"));
  EXPECT_THAT(acknowledging_stages(), ElementsAre("mapping", "integration"));
}

}  // namespace
}  // namespace zloam::runtime
