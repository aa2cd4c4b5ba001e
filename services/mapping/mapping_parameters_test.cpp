// Values that each key allows, but that mapping can't use, are refused with their key.

#include "mapping/mapping_parameters.hpp"

#include <gmock/gmock.h>

#include "common/runtime/tests/refusal.hpp"

namespace zloam::mapping {
namespace {

using testing::HasSubstr;

std::string refusal(const std::vector<std::string>& settings) {
  MappingConfig config;
  OutputConfig output;
  runtime::Parameters parameters;
  bind(parameters, config, output);
  return runtime::test::refusal_of(parameters, settings);
}

TEST(MappingParameters, NumbersOfTilesAreOdd) {
  EXPECT_EQ(refusal({}), "");
  EXPECT_EQ(refusal({"mapping.window_tiles=[9, 9, 5]", "mapping.local_tiles=[9, 9, 5]"}), "");
  EXPECT_THAT(refusal({"mapping.window_tiles=[20, 20, 10]"}),
              HasSubstr("mapping.window_tiles: must be odd numbers"));
  EXPECT_THAT(refusal({"mapping.local_tiles=[5, 5, 2]"}),
              HasSubstr("mapping.local_tiles: must be odd numbers"));
  EXPECT_THAT(refusal({"mapping.local_tiles=[23, 5, 3]"}),
              HasSubstr("mapping.local_tiles: must not exceed mapping.window_tiles"));
}

}  // namespace
}  // namespace zloam::mapping
