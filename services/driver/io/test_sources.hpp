#pragma once
// Shared by the tests of files and sockets: a separate folder for each, and one packet.

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "driver/io/packet_source.hpp"
#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver::test {

using velodyne::test::Payload;
using velodyne::test::TurningSensor;

using Bytes = std::vector<std::uint8_t>;

class Sources : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::temp_directory_path() /
              ("zloam-sources-" + std::to_string(getpid()) + "-" + info->name());
    std::filesystem::create_directories(folder_);
    TurningSensor sensor;
    const Payload payload = sensor.next();
    packet_.assign(payload.begin(), payload.end());
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::string write(const std::string& name, const Bytes& bytes) {
    const std::filesystem::path path = folder_ / name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
    return path.string();
  }

  static std::uint64_t count_of(const PacketSource& source, std::string_view name) {
    for (const auto& [key, value] : source.counts()) {
      if (key == name) return value;
    }
    ADD_FAILURE() << "no count " << name;
    return 0;
  }

  static std::string error_of(const std::function<void()>& action) {
    try {
      action();
    } catch (const SourceError& error) {
      return error.what();
    }
    return "no error";
  }

  std::filesystem::path folder_;
  Bytes packet_;
};

}  // namespace zloam::driver::test
