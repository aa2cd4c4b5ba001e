#include "driver/io/imu_file.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

class ImuFile : public testing::Test {
 protected:
  ~ImuFile() override { std::filesystem::remove(path_); }

  std::vector<ImuReading> read(const std::string& text) {
    std::ofstream(path_) << text;
    return read_imu_file(path_);
  }
  std::string refusal(const std::string& text) {
    try {
      read(text);
    } catch (const SourceError& error) {
      return error.what();
    }
    return "read";
  }

  std::string path_ = std::filesystem::temp_directory_path() /
                      ("imu_file_test." + std::to_string(getpid()) + ".csv");
};

constexpr const char* kNames = "t_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2";

TEST_F(ImuFile, ReadsWhatIsThere) {
  const auto readings = read(std::string(kNames) +
                             ",bias_wx\n"
                             "1704067210000000005,0.5,-0.25,1e-3,0.1,0.2,9.8,0.003\r\n"
                             "1704067210005000005,0,0,0,1,2,3,4\n\n");
  ASSERT_EQ(readings.size(), 2U);
  EXPECT_EQ(readings[0].stamp_ns, 1704067210000000005);
  EXPECT_EQ(readings[0].rate_radps, Eigen::Vector3d(0.5, -0.25, 1e-3));
  EXPECT_EQ(readings[0].force_mps2, Eigen::Vector3d(0.1, 0.2, 9.8));
  EXPECT_EQ(readings[1].force_mps2, Eigen::Vector3d(1.0, 2.0, 3.0));
}

TEST_F(ImuFile, TakesColumnsByName) {
  const auto readings =
      read("ax_m_s2,ay_m_s2,az_m_s2,note,wz_rad_s,wy_rad_s,wx_rad_s,t_ns\n1,2,3,here,4,5,6,7\n");
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].stamp_ns, 7);
  EXPECT_EQ(readings[0].rate_radps, Eigen::Vector3d(6.0, 5.0, 4.0));
}

TEST_F(ImuFile, NamesFileLineAndColumnOfWhatIsWrong) {
  EXPECT_EQ(refusal("t_ns,wx_rad_s\n1,2\n"), path_ + ":1: no column wy_rad_s in the line of names");
  EXPECT_EQ(refusal(std::string(kNames) + "\n1,0,0,0,0,0,9.8\n2,0,0,0,0,zero,9.8\n"),
            path_ + ":3: ay_m_s2: \"zero\" is no number");
  EXPECT_EQ(refusal(std::string(kNames) + "\n1,0,0,0,0,0\n"), path_ + ":2: has no az_m_s2");
  EXPECT_EQ(refusal(std::string(kNames) + "\n1,0,0,0,0,0,nan\n"),
            path_ + ":2: az_m_s2 is not finite");
  EXPECT_EQ(refusal(std::string(kNames) + "\n"), path_ + ": holds no reading");
  EXPECT_EQ(refusal(""), path_ + ": is empty");
  EXPECT_THROW(read_imu_file("/nowhere/imu.csv"), SourceError);
}

}  // namespace
}  // namespace zloam::driver
