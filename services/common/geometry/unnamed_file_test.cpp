#include "common/geometry/unnamed_file.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string_view>

namespace zloam {
namespace {

std::span<const std::byte> bytes_of(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

std::string read_back(const UnnamedFile& file, std::int64_t offset, std::size_t count) {
  std::string text(count, ' ');
  if (!file.read(offset, std::as_writable_bytes(std::span(text)))) return "unread";
  return text;
}

TEST(UnnamedFile, GivesBackWhatWasAppendedAndShowsNothingInTheFolder) {
  const std::string folder = testing::TempDir() + "/unnamed/inside";
  UnnamedFile file(folder);
  EXPECT_EQ(file.append(bytes_of("first")), 0);
  EXPECT_EQ(file.append(bytes_of("second")), 5);
  EXPECT_EQ(read_back(file, 5, 6), "second");
  EXPECT_EQ(read_back(file, 0, 5), "first");
  EXPECT_EQ(read_back(file, 5, 7), "unread");
  EXPECT_TRUE(std::filesystem::is_empty(folder));
  UnnamedFile moved = std::move(file);
  EXPECT_EQ(moved.append(bytes_of("third")), 11);
  EXPECT_EQ(read_back(moved, 0, 16), "firstsecondthird");
  EXPECT_FALSE(moved.failed());
}

TEST(UnnamedFile, SaysThatItCanNotWrite) {
  const std::string not_a_folder = testing::TempDir() + "/a-file";
  std::ofstream(not_a_folder) << "x";
  UnnamedFile file(not_a_folder);
  EXPECT_FALSE(file.failed());
  EXPECT_EQ(file.append(bytes_of("lost")), std::nullopt);
  EXPECT_TRUE(file.failed());
}

}  // namespace
}  // namespace zloam
