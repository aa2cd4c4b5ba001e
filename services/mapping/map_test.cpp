#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>

#include "common/containers/flat_index.hpp"
#include "common/geometry/map_file.hpp"
#include "mapping/grid_index.hpp"
#include "mapping/layer_map.hpp"
#include "mapping/tile_archive.hpp"

namespace zloam::mapping {
namespace {

std::string slurp(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

// A parser of the PCD header that shares nothing with the writer.
struct Pcd {
  std::map<std::string, std::vector<std::string>> header;
  std::string data;
};

Pcd parse(const std::string& bytes) {
  Pcd pcd;
  std::size_t at = 0;
  while (at < bytes.size()) {
    const std::size_t end = bytes.find('\n', at);
    std::istringstream line(bytes.substr(at, end - at));
    at = end + 1;
    std::string name, word;
    line >> name;
    if (name.starts_with("#")) continue;
    while (line >> word) pcd.header[name].push_back(word);
    if (name == "DATA") break;
  }
  pcd.data = bytes.substr(at);
  return pcd;
}

/// Yields the points in parts of this size.
NextPoints in_parts(const std::vector<LayeredPoint>& points, std::size_t part) {
  return [&points, part, at = std::size_t{0}]() mutable {
    const std::size_t end = std::min(at + part, points.size());
    const std::vector<LayeredPoint> next(points.begin() + static_cast<std::ptrdiff_t>(at),
                                         points.begin() + static_cast<std::ptrdiff_t>(end));
    at = end;
    return next;
  };
}

TEST(MapWriter, ReadsBack) {
  const std::vector<LayeredPoint> points = {{{1.5F, -2.0F, 3.25F, 7.0F}, Layer::kEdge},
                                            {{-100.5F, 0.0F, 1e-3F, 255.0F}, Layer::kPlane}};
  const std::string folder = testing::TempDir() + "map_writer_test/deeper";
  std::filesystem::remove_all(folder);
  const std::string path = folder + "/map.pcd";
  ASSERT_EQ(write_map(path, points.size(), in_parts(points, 1)), "");
  const Pcd pcd = parse(slurp(path));
  using Words = std::vector<std::string>;
  EXPECT_EQ(pcd.header.at("FIELDS"), (Words{"x", "y", "z", "intensity", "layer"}));
  EXPECT_EQ(pcd.header.at("SIZE"), (Words{"4", "4", "4", "4", "1"}));
  EXPECT_EQ(pcd.header.at("TYPE"), (Words{"F", "F", "F", "F", "U"}));
  EXPECT_EQ(pcd.header.at("WIDTH"), Words{"2"});
  EXPECT_EQ(pcd.header.at("POINTS"), Words{"2"});
  EXPECT_EQ(pcd.header.at("DATA"), Words{"binary"});
  ASSERT_EQ(pcd.data.size(), 34U);
  for (std::size_t i = 0; i < 2; ++i) {
    float xyzi[4];
    std::memcpy(xyzi, pcd.data.data() + 17 * i, 16);
    EXPECT_EQ(xyzi[0], points[i].point.x);
    EXPECT_EQ(xyzi[1], points[i].point.y);
    EXPECT_EQ(xyzi[2], points[i].point.z);
    EXPECT_EQ(xyzi[3], points[i].point.intensity);
    EXPECT_EQ(pcd.data[17 * i + 16], static_cast<char>(points[i].layer));
  }
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) files += entry.exists();
  EXPECT_EQ(files, 1U) << "no temporary file is left";
}

TEST(MapWriter, EmptyMapIsAFile) {
  const std::string path = testing::TempDir() + "map_writer_empty.pcd";
  ASSERT_EQ(write_map(path, 0, in_parts({}, 1)), "");
  const Pcd pcd = parse(slurp(path));
  EXPECT_EQ(pcd.header.at("POINTS"), std::vector<std::string>{"0"});
  EXPECT_TRUE(pcd.data.empty());
}

TEST(MapWriter, FailureLeavesWhatWasThere) {
  const std::string folder = testing::TempDir() + "map_writer_blocked";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder + "/map.pcd/in_the_way");
  EXPECT_NE(write_map(folder + "/map.pcd", 0, in_parts({}, 1)), "");
  EXPECT_TRUE(std::filesystem::is_directory(folder + "/map.pcd/in_the_way"));
}

TEST(MapWriter, AMapOfWhichAPartCannotBeReadReplacesNothing) {
  const std::string path = ::testing::TempDir() + "/part.pcd";
  const std::vector<LayeredPoint> points(7);
  ASSERT_EQ(write_map(path, points.size(), in_parts(points, 2)), "");
  const auto size = std::filesystem::file_size(path);
  EXPECT_EQ(write_map(path, points.size() + 2, in_parts(points, 2)),
            "cannot write " + path + ": only 7 of 9 points of the map can be read");
  EXPECT_EQ(std::filesystem::file_size(path), size);
}

/// Cuts every file of this process off that has no name in the folder any more.
void cut_unnamed_files_of(const std::string& folder) {
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code gone;
    const std::string file = std::filesystem::read_symlink(entry.path(), gone).string();
    if (file.find("(deleted)") == std::string::npos || !file.starts_with(folder)) continue;
    ASSERT_EQ(::ftruncate(std::stoi(entry.path().filename().string()), 0), 0);
  }
}

/// Bytes that these files take on the disk.
std::int64_t bytes_of_unnamed_files_of(const std::string& folder) {
  std::int64_t bytes = 0;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code gone;
    const std::string file = std::filesystem::read_symlink(entry.path(), gone).string();
    if (file.find("(deleted)") == std::string::npos || !file.starts_with(folder)) continue;
    struct stat about {};
    EXPECT_EQ(::fstat(std::stoi(entry.path().filename().string()), &about), 0);
    bytes += 512 * about.st_blocks;
  }
  return bytes;
}

// A robot that drives the same round for days takes each tile out and puts it back every time.
TEST(TileArchive, TilesThatComeBackLeaveNoRoomTakenInTheFile) {
  const std::string folder =
      std::filesystem::canonical(testing::TempDir()).string() + "/archive_rounds";
  std::filesystem::create_directories(folder);
  TileArchive archive(0, folder);
  constexpr int kTiles = 8, kRounds = 20;
  constexpr std::size_t kPoints = 4000;
  for (int round = 0; round < kRounds; ++round) {
    for (int i = 0; i < kTiles; ++i) {
      const TileId id{{i, 0, 0}, Layer::kPlane};
      auto points = std::vector<CountedPoint>(kPoints);
      if (round > 0) points = archive.take(id).value().points;
      ASSERT_EQ(points.size(), kPoints);
      archive.put(id, {1, std::move(points)});
    }
  }
  constexpr std::int64_t kOneRound = kTiles * kPoints * 32;
  // XFS reserves some more behind the end of a file that grows.
  EXPECT_LT(bytes_of_unnamed_files_of(folder), kRounds / 2 * kOneRound);
}

TEST(TileArchive, PointsThatCannotBeReadBackAreCountedOnceAndNeverForgotten) {
  const std::string folder =
      std::filesystem::canonical(testing::TempDir()).string() + "/archive_test";
  std::filesystem::create_directories(folder);
  TileArchive archive(0, folder);
  const TileId id{{1, 2, 3}, Layer::kPlane};
  const std::vector<CountedPoint> points(5);
  archive.put(id, {7, points});
  ASSERT_EQ(archive.get(id)->points.size(), 5U);
  cut_unnamed_files_of(folder);
  EXPECT_TRUE(archive.get(id)->points.empty());
  EXPECT_FALSE(archive.take(id));
  EXPECT_EQ(archive.unread_points(), 5U);
  EXPECT_EQ(archive.point_count(), 5U);
  archive.put(id, {8, std::vector<CountedPoint>(2)});
  EXPECT_EQ(archive.point_count(), 7U) << "of which a map file can have no more than two";
}

TEST(FlatIndex, BehavesLikeAMap) {
  FlatIndex index;
  std::map<std::uint64_t, std::uint32_t> reference;
  std::uint64_t state = 1;
  for (int i = 0; i < 20000; ++i) {
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    const std::uint64_t key = grid_key(static_cast<std::int64_t>(state >> 60) - 8, i % 7 - 3,
                                       static_cast<std::int64_t>(state >> 40 & 31) - 16);
    if (reference.contains(key) && (state >> 20 & 1) != 0) {
      index.erase(key);
      reference.erase(key);
    } else if (!reference.contains(key)) {
      index.insert(key, static_cast<std::uint32_t>(i));
      reference[key] = static_cast<std::uint32_t>(i);
    }
    ASSERT_EQ(index.size(), reference.size());
  }
  for (std::int64_t a = -8; a < 8; ++a) {
    for (std::int64_t b = -3; b < 4; ++b) {
      for (std::int64_t c = -16; c < 16; ++c) {
        const auto found = reference.find(grid_key(a, b, c));
        EXPECT_EQ(index.find(grid_key(a, b, c)),
                  found == reference.end() ? FlatIndex::kNone : found->second);
      }
    }
  }
}

TEST(GridIndex, KeysComeBack) {
  const std::int64_t last = (1 << 20) - 1;
  for (const GridIndex& index : {GridIndex(0, 0, 0), GridIndex(-1, 2, -3),
                                 GridIndex(last, -last - 1, last), GridIndex(-last - 1, last, 7)}) {
    EXPECT_EQ(unpack_key(pack_key(index)), index);
  }
}

TEST(LayerMap, MeanOfAllPointsOfAVoxelStays) {
  LayerMap map(0.4, 50.0);
  const Eigen::Vector3d centre(3.05, -7.1, 1.02);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < 1000; ++i) {
    const Eigen::Vector3d p = centre + 1e-3 * Eigen::Vector3d(i % 10, i % 7, i % 3);
    sum += p;
    map.insert(p, 2.0F);
  }
  ASSERT_EQ(map.point_count(), 1U);
  const auto points = map.tile_points(map.tiles().at(0));
  EXPECT_LT((points[0].mean - sum / 1000.0).norm(), 1e-9);
  EXPECT_EQ(points[0].count, 1000U);
  EXPECT_FLOAT_EQ(points[0].intensity, 2.0F);
}

// A robot that stands for days: more points in a voxel than a number of 32 bits can count.
TEST(LayerMap, AVoxelThatIsFullStaysWhereItIs) {
  LayerMap map(0.4, 50.0);
  const Eigen::Vector3d at(3.05, -7.1, 1.02);
  map.insert(at, 100.0F, std::numeric_limits<std::uint32_t>::max());
  const TileIndex tile = map.tiles().at(0);
  const std::uint64_t full = map.tile_count(tile);
  map.take_changed();
  for (int i = 0; i < 1000; ++i) map.insert(at, 100.0F);
  map.insert(at, 100.0F, std::numeric_limits<std::uint32_t>::max());
  ASSERT_EQ(map.tiles(), std::vector<TileIndex>{tile});
  const auto points = map.tile_points(tile);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_LT((points[0].mean - at).norm(), 1e-9);
  EXPECT_FLOAT_EQ(points[0].intensity, 100.0F);
  EXPECT_EQ(points[0].count, full);
  EXPECT_EQ(map.tile_count(tile), full);
  EXPECT_TRUE(map.take_changed().empty());
}

// Hours at one place: a sum in single precision of so many intensities takes no more of them.
TEST(LayerMap, TheIntensityOfAVoxelDoesNotFadeWithTheNumberOfItsPoints) {
  LayerMap map(0.4, 50.0);
  for (int i = 0; i < 1000; ++i) map.insert({3.05, -7.1, 1.02}, 100.0F, 1U << 15);
  for (int i = 0; i < 2'000'000; ++i) map.insert({3.05, -7.1, 1.02}, 100.0F);
  EXPECT_FLOAT_EQ(map.tile_points(map.tiles().at(0)).at(0).intensity, 100.0F);
}

TEST(LayerMap, FarPointsAreKeptOrCountedButNeverMixedUp) {
  LayerMap coarse(0.4, 50.0);
  const Eigen::Vector3d far(150'010.0, -3.0, 1.0);
  coarse.insert(far, 1.0F);
  ASSERT_EQ(coarse.tiles().size(), 1U);
  EXPECT_EQ(coarse.tiles()[0], (TileIndex{3000, -1, 0}));
  EXPECT_LT((coarse.tile_points(coarse.tiles()[0])[0].mean - far).norm(), 1e-6);
  EXPECT_EQ(coarse.left_out(), 0U);
  LayerMap fine(0.02, 50.0);
  fine.insert({1.0, 1.0, 1.0}, 1.0F);
  for (const double x_m : {40e3, -40e3, 1e15, std::numeric_limits<double>::infinity()}) {
    fine.insert({x_m, 0.0, 0.0}, 1.0F);
  }
  EXPECT_EQ(fine.point_count(), 1U);
  EXPECT_EQ(fine.left_out(), 2U) << "the others are no places";
}

TEST(LayerMap, CountsAllPointsOfATileAlsoOfVoxelsThatMoveToTheNext) {
  LayerMap map(0.4, 50.0);
  // Points around the border of two tiles, so that means of voxels cross it.
  std::uint64_t state = 3;
  for (int i = 0; i < 4000; ++i) {
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    const double x = 50.0 + 0.5 * (static_cast<double>(state >> 11) / 9007199254740992.0 - 0.5);
    map.insert({x, 3.0 + 0.3 * (i % 5), 1.0}, 1.0F);
  }
  std::uint64_t all = 0;
  for (const TileIndex& tile : map.tiles()) {
    std::uint64_t counted = 0;
    for (const CountedPoint& p : map.tile_points(tile)) counted += p.count;
    EXPECT_EQ(map.tile_count(tile), counted);
    all += counted;
  }
  EXPECT_EQ(all, 4000U);
  EXPECT_EQ(map.tiles().size(), 2U);
}

}  // namespace
}  // namespace zloam::mapping
