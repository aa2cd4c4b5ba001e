#include "common/messages/key_match.hpp"

#include <gtest/gtest.h>

namespace zloam {
namespace {

// Rules of Zenoh's key expressions: zenoh.io/docs/manual/abstractions.
TEST(KeyMatch, ChunksAndWildcards) {
  const char* key = "loam/r/map/tile/edge/0/-1/2";
  for (const char* yes :
       {"loam/r/map/tile/edge/0/-1/2", "loam/r/map/tile/**", "loam/*/map/**", "**",
        "loam/r/map/tile/edge/*/*/*", "**/2", "loam/**/tile/**/2", "loam/*/map/tile/*/*/*/*",
        "loam/**/tile/**", "loam/r/map/tile/edge/0/-1/2/**", "**/edge/*/-1/**", "**/loam/**"}) {
    EXPECT_TRUE(key_matches(yes, key)) << yes;
  }
  for (const char* no :
       {"loam/r/map/tile/plane/**", "loam/r/map/tile/edge/*/*", "loam/r/map", "", "**/3",
        "loam/r/map/tile/edge/0/-1/2/3", "loam/r/map/tile/edge/0/-1", "loam/r/map/tile/*",
        "loam/q/**", "loam/*/tile/**", "*", "loam/r/map/tile/edge/0/-1/2/*"}) {
    EXPECT_FALSE(key_matches(no, key)) << no;
  }
}

}  // namespace
}  // namespace zloam
