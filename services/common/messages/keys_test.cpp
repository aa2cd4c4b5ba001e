#include "common/messages/keys.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <string>
#include <vector>

namespace zloam {
namespace {

const std::filesystem::path kSchemas = ZLOAM_SCHEMAS_DIR;

TEST(Keys, AreFullAndNameRobotAndSensor) {
  const Keys keys("r1", "top");
  EXPECT_EQ(keys.of(Key::kSweep), "loam/r1/lidar/top/sweep");
  EXPECT_EQ(keys.of(Key::kImu), "loam/r1/imu/top");
  EXPECT_EQ(keys.of(Key::kOdometryFeatures), "loam/r1/odometry/features");
  EXPECT_EQ(keys.of(Key::kPose), "loam/r1/pose");
  EXPECT_EQ(keys.flow_ack("mapping"), "loam/r1/flow/mapping/ack");
  EXPECT_EQ(keys.tile("edge", -1, 0, 12), "loam/r1/map/tile/edge/-1/0/12");
  EXPECT_EQ(keys.status("driver", "a"), "loam/r1/service/driver/a/status");
  EXPECT_EQ(keys.alive("registration", "*"), "loam/r1/service/registration/*/alive");
  EXPECT_EQ(keys.config_revision("odometry"), "loam/r1/config/odometry");
  EXPECT_EQ(keys.config_revision("*"), "loam/r1/config/*");
  EXPECT_EQ(keys.command("mapping", "save"), "loam/r1/command/mapping/save");
}

TEST(Keys, TellWhoseTheyAre) {
  EXPECT_EQ(Keys::robot_of(Keys("r1", "top").tile("edge", -1, 0, 12)), "r1");
  EXPECT_EQ(Keys::robot_of("loam/r1"), "r1");
  for (const char* other : {"", "#map", "loam", "loam/", "other/r1/pose"}) {
    EXPECT_EQ(Keys::robot_of(other), "") << other;
  }
}

TEST(Keys, RefuseNamesThatWouldChangeTheKey) {
  for (const char* bad : {"", "a/b", "*", "**", "a?b", "a#b", "$*", "@x", "a b", "a\n"}) {
    EXPECT_THROW(Keys(bad, "top"), std::invalid_argument) << bad;
    EXPECT_THROW(Keys("r", bad), std::invalid_argument) << bad;
    EXPECT_FALSE(Keys::chunk_error(bad).empty()) << bad;
  }
  EXPECT_THROW(Keys("r", "s").command("mapping", "a/b"), std::invalid_argument);
  EXPECT_THROW(Keys("r", "s").of(Key::kMapTile), std::invalid_argument);
}

TEST(KeyTable, IsInOrderAndNamesSchemasThatExist) {
  std::set<std::string_view> patterns;
  for (std::size_t i = 0; i < key_table().size(); ++i) {
    const KeyRow& row = key_table()[i];
    EXPECT_EQ(static_cast<std::size_t>(row.key), i) << row.pattern;
    EXPECT_TRUE(patterns.insert(row.pattern).second) << row.pattern;
    if (!row.schema.empty()) {
      EXPECT_TRUE(std::filesystem::exists(kSchemas / (std::string(row.schema) + ".fbs")))
          << row.schema;
    }
  }
}

std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(" `");
  return first == std::string::npos ? std::string()
                                    : text.substr(first, text.find_last_not_of(" `") - first + 1);
}

/// Cells of all lines of the README's table that start with a key.
std::vector<std::vector<std::string>> readme_rows() {
  std::ifstream file(kSchemas / "README.md");
  std::vector<std::vector<std::string>> rows;
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("| `")) continue;
    std::vector<std::string> cells;
    std::istringstream stream(line.substr(1));
    for (std::string cell; std::getline(stream, cell, '|');) cells.push_back(trimmed(cell));
    rows.push_back(cells);
  }
  return rows;
}

std::string congestion_text(Congestion congestion) {
  switch (congestion) {
    case Congestion::kLiveDrop:
      return "drop live, block in replay";
    case Congestion::kDrop:
      return "drop";
    case Congestion::kQuery:
      return "-";
  }
  return "?";
}

std::string numbering_text(Numbering numbering) {
  switch (numbering) {
    case Numbering::kSweep:
      return "sweep";
    case Numbering::kSeq:
      return "seq";
    case Numbering::kNone:
      return "-";
  }
  return "?";
}

/// Liveliness tokens have no content.
std::string size_text(const KeyRow& row) {
  if (row.schema.empty()) return "-";
  std::size_t size = row.max_bytes >> 10;
  for (const char* unit : {" KiB", " MiB", " GiB"}) {
    if (size < 1024) return std::to_string(size) + unit;
    size >>= 10;
  }
  return "?";
}

TEST(KeyTable, IsTheOneOfTheReadme) {
  const auto rows = readme_rows();
  ASSERT_EQ(rows.size(), key_table().size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const KeyRow& row = key_table()[i];
    const std::vector<std::string> expected = {
        std::string(row.pattern),   row.schema.empty() ? "-" : std::string(row.schema),
        std::string(row.publisher), congestion_text(row.congestion),
        std::string(row.priority),  numbering_text(row.numbering),
        std::string(row.queue),     size_text(row)};
    EXPECT_EQ(rows[i], expected) << row.pattern;
  }
}

}  // namespace
}  // namespace zloam
