#include "store/key_expression.hpp"

#include <gtest/gtest.h>

namespace zloam::store {
namespace {

// Rules of Zenoh's key expressions: zenoh.io/docs/manual/abstractions.
TEST(KeyExpression, StarsAndDoubleStars) {
  const char* key = "loam/r/map/tile/edge/0/-1/2";
  for (const char* good : {"loam/r/map/tile/edge/0/-1/2", "loam/r/map/tile/**", "**", "loam/**/2",
                           "loam/*/map/tile/*/*/*/*", "loam/**/tile/**",
                           "loam/r/map/tile/edge/0/-1/2/**", "**/edge/*/-1/**", "**/loam/**"}) {
    EXPECT_TRUE(covers(good, key)) << good;
  }
  for (const char* bad :
       {"loam/r/map/tile/edge/0/-1", "loam/r/map/tile/*", "loam/q/**", "loam/r/map/tile/plane/**",
        "**/3", "loam/*/tile/**", "*", "loam/r/map/tile/edge/0/-1/2/*"}) {
    EXPECT_FALSE(covers(bad, key)) << bad;
  }
}

}  // namespace
}  // namespace zloam::store
