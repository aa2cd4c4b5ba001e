#include "common/runtime/session_config.hpp"

#include <gmock/gmock.h>

namespace zloam::runtime {
namespace {

using testing::Contains;
using testing::Each;
using testing::ElementsAre;
using testing::Not;
using testing::StartsWith;

TEST(Endpoints, AStageListensOnItsPortAndConnectsToItsSiblings) {
  ZenohConfig config;
  config.host = "10.0.0.5";
  config.base_port = 7000;
  const Endpoints e = endpoints_of(config, "odometry");
  EXPECT_THAT(e.listen, ElementsAre("tcp/10.0.0.5:7002"));
  EXPECT_THAT(e.connect, Each(StartsWith("tcp/10.0.0.5:70")));
  EXPECT_THAT(e.connect, Not(Contains("tcp/10.0.0.5:7002")));
  EXPECT_THAT(e.connect, Contains("tcp/10.0.0.5:7003"));
}

TEST(Endpoints, OnAllInterfacesSiblingsAreReachedOnThisMachine) {
  ZenohConfig config;
  config.base_port = 7000;
  config.host = "0.0.0.0";
  EXPECT_THAT(endpoints_of(config, "driver").listen, ElementsAre("tcp/0.0.0.0:7000"));
  EXPECT_THAT(endpoints_of(config, "driver").connect, Each(StartsWith("tcp/127.0.0.1:")));
  config.host = "[::]";
  EXPECT_THAT(endpoints_of(config, "driver").connect, Each(StartsWith("tcp/[::1]:")));
}

}  // namespace
}  // namespace zloam::runtime
