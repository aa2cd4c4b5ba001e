// Checks of JSON text (size, depth) before it is parsed.

#include "common/runtime/json_guard.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

std::string nested(int levels, char open, char close) {
  return std::string(static_cast<std::size_t>(levels), open) +
         std::string(static_cast<std::size_t>(levels), close);
}

TEST(JsonGuard, LetsThroughWhatACommandIs) {
  EXPECT_EQ(json_error(""), "");
  EXPECT_EQ(json_error(R"({"registration.points": 20, "path": "a[b]"})"), "");
  EXPECT_EQ(json_error("odometry.kernel_m=0.2\nmapping.layers=[1, 2]"), "");
  EXPECT_EQ(json_error(nested(kDeepestText, '[', ']')), "");
  // Many brackets side by side are not deep.
  std::string many;
  for (int i = 0; i < 1000; ++i) many += "{}[]";
  EXPECT_EQ(json_error(many), "");
}

TEST(JsonGuard, RefusesDepthHoweverItIsMade) {
  for (const int levels : {kDeepestText + 1, 1000, 30'000}) {
    EXPECT_NE(json_error(nested(levels, '[', ']')), "") << levels;
    EXPECT_NE(json_error(nested(levels, '{', '}')), "") << levels;
    EXPECT_NE(json_error(std::string(static_cast<std::size_t>(levels), '[')), "") << levels;
  }
  // Objects in arrays; closing brackets before the opening ones; an open quote before them.
  std::string mixed;
  for (int i = 0; i < 100; ++i) mixed += R"([{"a":)";
  EXPECT_NE(json_error(mixed), "");
  EXPECT_NE(json_error("]]]]]]]]" + std::string(20, '[')), "");
  EXPECT_NE(json_error("\"" + std::string(20, '[')), "");
}

TEST(JsonGuard, RefusesMoreThanACommandCanBe) {
  EXPECT_EQ(json_error(std::string(kMostText_bytes, ' ')), "");
  EXPECT_NE(json_error(std::string(kMostText_bytes + 1, ' ')), "");
}

}  // namespace
}  // namespace zloam::runtime
