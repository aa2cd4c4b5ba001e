// Values that each key allows, but that contradict each other, are refused with their key.

#include "driver/driver_parameters.hpp"

#include <gmock/gmock.h>

#include "common/runtime/tests/refusal.hpp"

namespace zloam::driver {
namespace {

using testing::HasSubstr;

std::string refusal(const std::vector<std::string>& settings) {
  DriverConfig config;
  runtime::Parameters parameters;
  bind(parameters, config);
  return runtime::test::refusal_of(parameters, settings);
}

TEST(DriverParameters, ABodyBoxWithoutInsideIsRefused) {
  const std::string low = "driver.body_box_min_m=[-0.4, -0.3, -1]";
  EXPECT_EQ(refusal({low, "driver.body_box_max_m=[0.4, 0.3, 0]"}), "");
  EXPECT_EQ(refusal({"driver.body_box_min_m=[0, 0, 0]", "driver.body_box_max_m=[0, 0, 0]"}), "");
  for (const char* high : {"[0.4, -0.3, 0]", "[0.4, 0.3, -2]", "[-0.4, -0.3, -1]"}) {
    EXPECT_THAT(refusal({low, std::string("driver.body_box_max_m=") + high}),
                HasSubstr("driver.body_box_max_m: must be above driver.body_box_min_m"))
        << high;
  }
  EXPECT_THAT(refusal({"driver.body_box_min_m=[0.1, 0.1, 0.1]"}),
              HasSubstr("--set driver.body_box_min_m: driver.body_box_max_m: must be above"));
}

TEST(DriverParameters, TwoKindsOfPacketsNeedTwoPorts) {
  EXPECT_EQ(refusal({"driver.position_port=2368"}),
            "--set driver.position_port: driver.position_port: must differ from driver.port");
  EXPECT_EQ(refusal({"driver.port=8308"}),
            "--set driver.port: driver.position_port: must differ from driver.port");
  EXPECT_EQ(refusal({"driver.port=0", "driver.position_port=0"}), "");
  EXPECT_EQ(refusal({"driver.position_port=2368", "driver.source=zenoh"}), "");
}

TEST(DriverParameters, WhatASourceNeedsIsAskedForAtTheSource) {
  const std::string source = "driver.source=kitti";
  EXPECT_THAT(refusal({source}), HasSubstr("--set driver.source: driver.path: is empty"));
  EXPECT_THAT(refusal({source}), HasSubstr("--set driver.source: driver.time_model: is none"));
  EXPECT_THAT(refusal({"driver.source=pcap", "driver.path=x.pcap", "driver.imu=file"}),
              HasSubstr("--set driver.imu: driver.imu_path: is empty"));
}

TEST(DriverParameters, AddressesThatCantBeUsedAreNamedWithTheirKey) {
  EXPECT_EQ(refusal({"driver.bind_address=192.168.1.77", "driver.multicast_group=239.0.0.1"}), "");
  EXPECT_EQ(refusal({"driver.bind_address=", "driver.multicast_group="}), "");
  EXPECT_THAT(refusal({"driver.bind_address=localhost"}),
              HasSubstr("driver.bind_address: \"localhost\" is no IPv4 address"));
  EXPECT_THAT(refusal({"driver.multicast_group=group"}),
              HasSubstr("driver.multicast_group: \"group\" is no IPv4 address"));
  EXPECT_THAT(refusal({"driver.multicast_group=192.168.1.201"}),
              HasSubstr("driver.multicast_group: \"192.168.1.201\" is no multicast group"));
}

TEST(DriverParameters, APaceIsADecimalNumber) {
  for (const char* rate : {"max", "realtime", "0.5", "1e-1", "1000"}) {
    EXPECT_EQ(refusal({std::string("driver.rate=") + rate}), "") << rate;
  }
  for (const char* rate : {"0x10", "' 2'", "'2 '", "0", "-1", "inf", "nan", "1e-300", "1e300"}) {
    EXPECT_THAT(refusal({std::string("driver.rate=") + rate}),
                HasSubstr("driver.rate: is none of max, realtime, or a factor"))
        << rate;
  }
}

TEST(DriverParameters, AMaskLeavesSomething) {
  for (const char* mask : {"[]", "[350, 10]", "[0, 359.9]", "[10, 9]", "[0, 180, 181, 360]"}) {
    EXPECT_EQ(refusal({std::string("driver.azimuth_mask_deg=") + mask}), "") << mask;
  }
  for (const char* mask : {"[0, 360]", "[0, 180, 180, 360]", "[350, 200, 150, 355]"}) {
    EXPECT_THAT(refusal({std::string("driver.azimuth_mask_deg=") + mask}),
                HasSubstr("driver.azimuth_mask_deg: hides every direction"))
        << mask;
  }
  EXPECT_THAT(refusal({"driver.azimuth_mask_deg=[0x10, 20]"}), HasSubstr("is no angle"));
}

}  // namespace
}  // namespace zloam::driver
