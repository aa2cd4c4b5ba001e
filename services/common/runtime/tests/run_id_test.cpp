#include "common/runtime/run_id.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

TEST(RunId, IsAFunctionOfCaptureAndConfigurations) {
  // SHA-256 of the empty text, FIPS 180-4's well-known value.
  EXPECT_EQ(sha256_hex(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  const std::uint64_t run = replay_run_id("c", {{"a", "1"}, {"b", "2"}});
  EXPECT_EQ(run, replay_run_id("c", {{"b", "2"}, {"a", "1"}}));
  EXPECT_NE(run, replay_run_id("d", {{"a", "1"}, {"b", "2"}}));
  EXPECT_NE(run, replay_run_id("c", {{"a", "1"}, {"b", "3"}}));
  EXPECT_NE(run, replay_run_id("c", {{"a", "1"}}));
}

}  // namespace
}  // namespace zloam::runtime
