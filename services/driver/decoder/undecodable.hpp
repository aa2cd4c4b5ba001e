#pragma once
// Replaces a decoder when packets are a maker's but can't be decoded: reports why.

#include <string>
#include <utility>

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

class Undecodable final : public PacketDecoder {
 public:
  explicit Undecodable(std::string text) { contradictions_.push_back(std::move(text)); }

  PacketTail tail(std::span<const std::uint8_t> /*payload*/) override {
    PacketTail tail;
    tail.reject = Reject::kUnknownModel;
    return tail;
  }
  PacketPlan plan(std::span<const std::uint8_t> /*payload*/, ReturnMode /*mode*/) override {
    return {};
  }
  std::size_t decode_groups(const PacketPlan& /*plan*/, std::span<const PlacedGroup> /*groups*/,
                            Point* /*out*/, std::uint16_t* /*columns*/) const override {
    return 0;
  }
};

}  // namespace zloam::driver
