#pragma once
// Data packets of Ouster's OS sensors to points. A firing group is a column: the pixels of all
// lasers at one encoder angle. Columns are numbered round the frame, clockwise from the rear.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "driver/decoder/maker.hpp"
#include "driver/ouster/column_points.hpp"
#include "driver/ouster/metadata.hpp"
#include "driver/ouster/packet.hpp"

namespace zloam::driver::ouster {

class Decoder final : public PacketDecoder {
 public:
  Decoder(const Metadata& metadata, const DecodingOptions& options);

  PacketTail tail(std::span<const std::uint8_t> payload) override;
  PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode) override;
  std::size_t decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups, Point* out,
                            std::uint16_t* columns) const override;

 private:
  void shape_stream();
  Reject check_header(std::span<const std::uint8_t> payload);
  void note_once(bool& noted, std::string text);
  std::int64_t next_packet_ns(int first_column) const;

  Metadata metadata_;
  std::vector<ColumnPose> poses_;
  std::vector<int> azimuth_cdeg_;
  ColumnReader reader_;
  PacketLayout layout_;
  ReturnMode mode_;
  bool size_noted_ = false;
  bool serial_noted_ = false;
  bool start_noted_ = false;
};

}  // namespace zloam::driver::ouster
