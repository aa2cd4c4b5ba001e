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

TEST_F(ImuFile, TablesOfOtherProgramsAreRead) {
  const std::string rows = "100000000,+0.5,-0.25,1e-3,0.1,0.2,9.8\n105000000,0,0,0,1,2,3\n";
  const auto with = [](std::string text, char from, const std::string& to) {
    std::string out;
    for (const char c : text) c == from ? out += to : out += c;
    return out;
  };
  const std::string plain = std::string(kNames) + "\n" + rows;
  const std::string decimal_comma =
      with(kNames, ',', ";") + "\n" + with(with(rows, ',', ";"), '.', ",");
  for (const std::string& text :
       {plain, "\xEF\xBB\xBF" + plain, with(plain, '\n', "\r\n"), with(plain, ',', ", "),
        with(plain, ',', " ,"), with(plain, ',', ";"), with(plain, ',', "\t"), decimal_comma,
        "#" + plain, "# " + plain, "\"" + with(kNames, ',', "\",\"") + "\"\n" + rows,
        plain + " \n\r\n", std::string(kNames) + "\n# gap\n" + rows,
        std::string(kNames) + "\n" + kNames + "\n" + rows}) {
    const auto readings = read(text);
    ASSERT_EQ(readings.size(), 2U) << text;
    EXPECT_EQ(readings[0].stamp_ns, 100'000'000);
    EXPECT_EQ(readings[0].rate_radps, Eigen::Vector3d(0.5, -0.25, 1e-3));
    EXPECT_EQ(readings[0].force_mps2, Eigen::Vector3d(0.1, 0.2, 9.8));
  }
}

TEST_F(ImuFile, NamesTheUnitAndTheOrderOfStamps) {
  const auto rows = [](const std::vector<std::string>& stamps) {
    std::string text = std::string(kNames) + "\n";
    for (const std::string& stamp : stamps) text += stamp + ",0,0,0,0,0,9.8\n";
    return text;
  };
  EXPECT_EQ(refusal(rows({"1704067210.005", "1704067210.010"})),
            path_ + ":2: t_ns: \"1704067210.005\" is no whole number of nanoseconds");
  EXPECT_EQ(refusal(rows({"1.7e18", "1.8e18"})),
            path_ + ":2: t_ns: \"1.7e18\" is no whole number of nanoseconds");
  EXPECT_EQ(refusal(rows({"1704067210005000", "1704067210010000", "1704067210015000"})),
            path_ + ": its stamps are 5000 apart: t_ns is in nanoseconds, as if they were us");
  EXPECT_EQ(refusal(rows({"1704067210005", "1704067210010", "1704067210015"})),
            path_ + ": its stamps are 5 apart: t_ns is in nanoseconds, as if they were ms");
  EXPECT_EQ(refusal(rows({"30000000", "20000000", "10000000"})),
            path_ + ": the stamps descend: sort the lines by t_ns");
  EXPECT_EQ(refusal("\xFF\xFEt"), path_ + ": is UTF-16; UTF-8 is expected");
}

TEST_F(ImuFile, RefusesStampsThatGoBackByASecond) {
  const auto rows = [](std::int64_t set_back_ns) {
    std::string text = std::string(kNames) + "\n";
    for (int i = 0; i < 20; ++i) {
      const std::int64_t stamp_ns = 5'000'000'000 + 5'000'000LL * i - (i < 10 ? 0 : set_back_ns);
      text += std::to_string(stamp_ns) + ",0,0,0,0,0,9.8\n";
    }
    return text;
  };
  EXPECT_EQ(refusal(rows(2'000'000'000)),
            path_ +
                ": its stamps go back from 5045000000 to 3050000000 ns: sort the lines by "
                "t_ns, or leave out those of another clock");
  EXPECT_EQ(read(rows(500'000'000)).size(), 20U);
}

TEST_F(ImuFile, SaysWhenTheSensorHung) {
  std::string text = std::string(kNames) + "\n";
  for (int i = 0; i < 200; ++i) {
    text += std::to_string(5'000'000LL * (i + 1)) + "," + std::to_string(std::min(i, 100)) +
            ",0,0,0,0,9.8\n";
  }
  EXPECT_NE(standstill_in(read(text)).find("from 505000000 ns on"), std::string::npos);
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
