#pragma once
// Data packets of Hesai's PandarXT sensors to points. A firing group is a block, or with two
// returns a pair of blocks: the measurements of all lasers from one azimuth on. Each laser fires a
// little later, and the motor moves on meanwhile:
//
//   azimuth   = block's azimuth + laser's offset + speed * (laser's firing after the first one's)
//   direction = (cos elevation cos azimuth, -cos elevation sin azimuth, sin elevation)
//
// (manual, "Point Cloud Data Analysis"; its y axis, where azimuth is 0, is our x axis).

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "driver/decoder/maker.hpp"
#include "driver/decoder/motor.hpp"
#include "driver/decoder/raw_limits.hpp"
#include "driver/hesai/beams.hpp"
#include "driver/hesai/packet.hpp"

namespace zloam::driver::hesai {

class Decoder final : public PacketDecoder {
 public:
  /// header: of the stream's packets; beams: as many as it has lasers.
  Decoder(const Header& header, const std::vector<Beam>& beams, const DecodingOptions& options);

  PacketTail tail(std::span<const std::uint8_t> payload) override;
  PacketPlan plan(std::span<const std::uint8_t> payload, ReturnMode mode) override;
  std::size_t decode_groups(const PacketPlan& plan, std::span<const PlacedGroup> groups, Point* out,
                            std::uint16_t* columns) const override;

 private:
  /// Constants of a laser.
  struct Laser {
    double cos_elevation, elevation_rad, offset_rad;
    std::uint32_t time_ns;
    std::uint16_t ring;
  };
  /// Direction of a beam relative to the block's azimuth.
  struct Direction {
    float along, across, up;
  };
  /// Cosine and sine of a group's azimuth, and values common to its points.
  struct Frame {
    float cos_azimuth, sin_azimuth;
    std::uint32_t time_ns;
  };
  struct Sink {
    Point* at;
    void put(const Point& point, bool kept) {
      *at = point;
      at += kept;
    }
  };

  void shape_stream();
  void note_once(bool& noted, std::string text);
  void check_options(const Tail& tail);
  PacketPlan groups_of(std::span<const std::uint8_t> payload, ReturnMode mode) const;
  void follow(double advance_cdeg);
  const std::uint8_t* block(const std::uint8_t* payload, int index) const;
  Point point_of(std::size_t laser, const std::uint8_t* cell, const Frame& frame,
                 ReturnType type) const;
  void put_block(const std::uint8_t* block, const Frame& frame, ReturnType type, Sink& sink) const;
  void put_pair(const std::uint8_t* odd, const std::uint8_t* even, const Frame& frame, Pair pair,
                Sink& sink) const;

  Header header_;
  DecodingOptions options_;
  std::vector<Laser> lasers_;
  std::array<Direction, kMostLasers> directions_{};
  Motor motor_;
  float unit_m_;
  RawLimits limits_;
  double followed_cdeg_ = -1.0;
  bool mode_noted_ = false;
  bool returns_noted_ = false;
  bool other_noted_ = false;
};

}  // namespace zloam::driver::hesai
