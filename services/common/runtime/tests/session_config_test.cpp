#include "common/runtime/session_config.hpp"

#include <gmock/gmock.h>

#include "common/runtime/parameters.hpp"

namespace zloam::runtime {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;
using testing::StartsWith;

TEST(Endpoints, AStageListensOnItsPortAndConnectsToThoseBehindIt) {
  ZenohConfig config;
  config.host = "10.0.0.5";
  config.base_port = 7000;
  config.connect = {"tcp/router:7447"};
  const Endpoints e = endpoints_of(config, "odometry");
  EXPECT_THAT(e.listen, ElementsAre("tcp/10.0.0.5:7002"));
  EXPECT_THAT(e.connect, ElementsAre("tcp/10.0.0.5:7003", "tcp/10.0.0.5:7004", "tcp/router:7447"));
}

TEST(Endpoints, WhatIsNoEndpointIsRefusedWithItsKey) {
  for (const char* good : {"tcp/router:7447", "tcp/[::1]:7447", "tcp/10.0.0.5:0",
                           "tcp/10.0.0.5:7447?prio=1-3#iface=eth0"}) {
    ZenohConfig config;
    config.connect = config.listen = {good};
    EXPECT_NO_THROW(check_endpoints(config)) << good;
  }
  for (const char* bad : {"", "7447", "tcp/7447", "router:7447", "tcp/router", "tcp/router:",
                          "tcp/:7447", "tcp/router:70000", "tcp/router:7447x", "udp/router:7447",
                          "tcp/my router:7447", "tcp/a/b:7447", "tcp/router?a:7447"}) {
    ZenohConfig config;
    config.connect = {"tcp/router:7447", bad};
    try {
      endpoints_of(config, "odometry");
      ADD_FAILURE() << bad;
    } catch (const ConfigError& e) {
      EXPECT_THAT(e.what(),
                  AllOf(HasSubstr("zenoh.connect"), HasSubstr("'" + std::string(bad) + "'"),
                        HasSubstr("tcp/HOST:PORT")));
    }
  }
}

TEST(Endpoints, WithoutALinkAreThoseThatNoneLeadsTo) {
  const std::vector<std::string> links = {"tcp/172.18.0.2:7447", "tcp/10.0.0.9:51234",
                                          "tcp/127.0.0.1:40000", "tcp/[fe80::1]:7447"};
  const auto missing = [&links](std::vector<std::string> endpoints) {
    return without_link(endpoints, links);
  };
  EXPECT_THAT(missing({}), IsEmpty());
  EXPECT_THAT(missing({"tcp/router:7447"}), IsEmpty());
  // A link made by the other side comes from an outgoing port.
  EXPECT_THAT(missing({"tcp/10.0.0.9:7464"}), IsEmpty());
  // A peer on this host is no router on this host.
  EXPECT_THAT(missing({"tcp/127.0.0.1:7450"}), ElementsAre("tcp/127.0.0.1:7450"));
  // "All interfaces" means this host.
  EXPECT_THAT(missing({"tcp/0.0.0.0:40000"}), IsEmpty());
  EXPECT_THAT(missing({"tcp/[::]:40000"}), IsEmpty());
  EXPECT_THAT(missing({"tcp/0.0.0.0:7450"}), ElementsAre("tcp/0.0.0.0:7450"));
  EXPECT_THAT(missing({"tcp/10.0.0.8:7447"}), ElementsAre("tcp/10.0.0.8:7447"));
  // A stage on the router's host is no router.
  EXPECT_THAT(missing({"tcp/172.18.0.2:7463"}), ElementsAre("tcp/172.18.0.2:7463"));
  EXPECT_THAT(missing({"tcp/[fe80::1]:7447#iface=eth0"}), IsEmpty());
  // Two links have that port, so the third router has none; an endpoint named twice counts once.
  EXPECT_THAT(missing({"tcp/a:7447", "tcp/a:7447", "tcp/b:7447", "tcp/c:7447"}),
              ElementsAre("tcp/c:7447"));
}

TEST(Endpoints, OfTwoStagesExactlyOneConnects) {
  ZenohConfig config;
  config.base_port = 7000;
  for (const StageRow& a : stage_list()) {
    for (const StageRow& b : stage_list()) {
      // Programs that are both outside the chain need no link.
      if (a.name == b.name || !(a.in_chain || b.in_chain)) continue;
      const Endpoints first = endpoints_of(config, a.name);
      const Endpoints second = endpoints_of(config, b.name);
      const bool forth = testing::Value(first.connect, Contains(second.listen.front()));
      const bool back = testing::Value(second.connect, Contains(first.listen.front()));
      EXPECT_NE(forth, back) << a.name << ", " << b.name;
      EXPECT_EQ(forth, first.initiative > second.initiative) << a.name << ", " << b.name;
    }
  }
}

TEST(Endpoints, SecondInstancesAndOthersConnectToAllOfTheChain) {
  ZenohConfig config;
  config.base_port = 7000;
  config.listen = {"tcp/127.0.0.1:0"};
  for (const char* stage : {"registration", "store"}) {
    const Endpoints e = endpoints_of(config, stage);
    EXPECT_EQ(e.listen, config.listen);
    EXPECT_EQ(e.connect.size(), 5) << stage;
    EXPECT_GT(e.initiative, endpoints_of(ZenohConfig{}, "driver").initiative);
  }
}

TEST(Endpoints, OnAllInterfacesSiblingsAreReachedOnThisMachine) {
  ZenohConfig config;
  config.base_port = 7000;
  config.host = "0.0.0.0";
  EXPECT_THAT(endpoints_of(config, "driver").listen, ElementsAre("tcp/0.0.0.0:7000"));
  // The four stages behind it; of none, each would do.
  EXPECT_THAT(endpoints_of(config, "driver").connect,
              AllOf(SizeIs(4), Each(StartsWith("tcp/127.0.0.1:"))));
  config.host = "[::]";
  EXPECT_THAT(endpoints_of(config, "driver").connect,
              AllOf(SizeIs(4), Each(StartsWith("tcp/[::1]:"))));
}

TEST(Endpoints, EachStageMayHaveAHostOfItsName) {
  ZenohConfig config;
  config.base_port = 7000;
  config.host = "<stage>2.robots";
  const Endpoints e = endpoints_of(config, "odometry");
  EXPECT_THAT(e.listen, ElementsAre("tcp/0.0.0.0:7002"));
  EXPECT_THAT(e.connect, ElementsAre("tcp/mapping2.robots:7003", "tcp/integration2.robots:7004"));
}

}  // namespace
}  // namespace zloam::runtime
