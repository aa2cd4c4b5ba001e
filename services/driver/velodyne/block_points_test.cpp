// Compares the vectorized versions that convert a block to points with the portable one.
#include "driver/velodyne/block_points.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <random>
#include <vector>

#include "driver/velodyne/block_points_wide.hpp"

namespace zloam::driver::velodyne {
namespace {

// A block, and the bytes of the packet after it.
using Block = std::array<std::uint8_t, kBlockBytes + 6>;
using Put = decltype(put_single);

struct Written {
  std::vector<Point> points;
  std::vector<std::uint16_t> columns;
};

Written written_by(Put* put, std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                   RawLimits limits) {
  const std::size_t most = blocks.size() * kCellsPerBlock + 1;
  Written written{std::vector<Point>(most), std::vector<std::uint16_t>(most)};
  PointSink sink{written.points.data(), written.columns.data()};
  put(blocks, beams, bank, limits, ReturnType::kLast, sink);
  written.points.resize(sink.count);
  written.columns.resize(sink.count);
  return written;
}

/// Random bytes, with no return in about every third cell.
Block some_block(std::mt19937& random) {
  Block block;
  for (std::uint8_t& byte : block) byte = static_cast<std::uint8_t>(random());
  for (std::size_t c = 0; c < kCellsPerBlock; ++c) {
    if (random() % 3 == 0) std::memset(&block[4 + 3 * c], 0, 2);
  }
  return block;
}

/// All versions except the portable one that this processor can run.
std::vector<Put*> quick_ways() {
  std::vector<Put*> ways{put_single};
#if ZLOAM_WIDE
  if (has_avx2()) ways.push_back(put_single_avx2);
  if (has_avx512()) ways.push_back(put_single_avx512);
#endif
  return ways;
}

std::size_t returns_in(const Block& block, RawLimits limits) {
  std::size_t returns = 0;
  for (std::size_t c = 0; c < kCellsPerBlock; ++c) {
    returns += limits.contain(read_u16(&block[4 + 3 * c]));
  }
  return returns;
}

void expect_same(const Written& quick, const Written& portable) {
  ASSERT_EQ(quick.points.size(), portable.points.size());
  EXPECT_EQ(std::memcmp(quick.points.data(), portable.points.data(),
                        sizeof(Point) * portable.points.size()),
            0);
  EXPECT_EQ(quick.columns, portable.columns);
}

TEST(BlockPoints, TheQuickWaysGiveTheSameBytesAsThePortableOne) {
  std::mt19937 random(5);
  for (const Model model : {Model::kVlp16, Model::kHdl32e, Model::kVls128}) {
    const ModelTable& table = model_table(model);
    BeamTables beams(table, 1.0, true);
    beams.follow(20.0);
    for (int i = 0; i < 200; ++i) {
      const std::array<Block, 2> blocks{some_block(random), some_block(random)};
      const int bank = i % table.banks;
      const BlockFrame frame{0.6F, -0.8F, static_cast<float>(table.distance_unit_m),
                             static_cast<std::uint32_t>(random() % 100'000'000), 7};
      const BlockFrame next{0.8F, -0.6F, frame.unit_m, frame.time_ns + 55'296, 9};
      const std::array<FiredBlock, 2> fired{{{blocks[0].data(), frame}, {blocks[1].data(), next}}};
      for (const RawLimits limits :
           {RawLimits{}, RawLimits{500, 20'000}, RawLimits{65'536, 0}, RawLimits{1, 0}}) {
        const Written portable = written_by(put_single_portable, fired, beams, bank, limits);
        EXPECT_EQ(portable.points.size(),
                  returns_in(blocks[0], limits) + returns_in(blocks[1], limits));
        for (Put* way : quick_ways()) {
          expect_same(written_by(way, fired, beams, bank, limits), portable);
        }
      }
    }
  }
}

}  // namespace
}  // namespace zloam::driver::velodyne
