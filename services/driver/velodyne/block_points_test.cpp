// The quick way to a block's points against the portable one.
#include "driver/velodyne/block_points.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <random>
#include <vector>

namespace zloam::driver {
namespace {

// A block, and what follows it in a packet.
using Block = std::array<std::uint8_t, kBlockBytes + 6>;
using Put = decltype(put_single);

struct Written {
  std::vector<Point> points;
  std::vector<std::uint16_t> columns;
};

Written written_by(Put* put, const Block& block, const BeamTables& beams, int bank,
                   const BlockFrame& frame, RawLimits limits) {
  Written written{std::vector<Point>(kCellsPerBlock + 1),
                  std::vector<std::uint16_t>(kCellsPerBlock + 1)};
  PointSink sink{written.points.data(), written.columns.data()};
  put(block.data(), beams, bank, frame, limits, ReturnType::kLast, sink);
  written.points.resize(sink.count);
  written.columns.resize(sink.count);
  return written;
}

/// Noise, with no return in every third cell.
Block some_block(std::mt19937& random) {
  Block block;
  for (std::uint8_t& byte : block) byte = static_cast<std::uint8_t>(random());
  for (std::size_t c = 0; c < kCellsPerBlock; ++c) {
    if (random() % 3 == 0) std::memset(&block[4 + 3 * c], 0, 2);
  }
  return block;
}

TEST(BlockPoints, TheQuickWayGivesTheSameBytesAsThePortableOne) {
  std::mt19937 random(5);
  for (const Model model : {Model::kVlp16, Model::kHdl32e, Model::kVls128}) {
    const ModelTable& table = model_table(model);
    BeamTables beams(table, 1.0, true);
    beams.follow(20.0);
    for (int i = 0; i < 200; ++i) {
      const Block block = some_block(random);
      const int bank = i % table.banks;
      const BlockFrame frame{0.6F, -0.8F, static_cast<float>(table.distance_unit_m),
                             static_cast<std::uint32_t>(random() % 100'000'000), 7};
      for (const RawLimits limits :
           {RawLimits{}, RawLimits{500, 20'000}, RawLimits{65'536, 0}, RawLimits{1, 0}}) {
        const Written quick = written_by(put_single, block, beams, bank, frame, limits);
        const Written portable = written_by(put_single_portable, block, beams, bank, frame, limits);
        ASSERT_EQ(quick.points.size(), portable.points.size());
        EXPECT_EQ(std::memcmp(quick.points.data(), portable.points.data(),
                              sizeof(Point) * portable.points.size()),
                  0);
        EXPECT_EQ(quick.columns, portable.columns);
        std::size_t returns = 0;
        for (std::size_t c = 0; c < kCellsPerBlock; ++c) {
          returns += limits.contain(read_u16(&block[4 + 3 * c]));
        }
        EXPECT_EQ(portable.points.size(), returns);
      }
    }
  }
}

}  // namespace
}  // namespace zloam::driver
