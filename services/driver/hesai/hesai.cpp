#include "driver/hesai/hesai.hpp"

#include <utility>
#include <variant>

#include "driver/decoder/label.hpp"
#include "driver/decoder/undecodable.hpp"
#include "driver/hesai/decoder.hpp"

namespace zloam::driver::hesai {
namespace {

std::string unknown_text(const Header& header) {
  return "the packets are a Hesai sensor's (protocol " + std::to_string(header.protocol_major) +
         "." + std::to_string(header.protocol_minor) + ", " + std::to_string(header.lasers) +
         " lasers, " + std::to_string(header.blocks) +
         " blocks) that is not decoded here; PandarXT-16 and PandarXT-32 are. Its driver's clouds "
         "can be used instead: docs/your-own-sensor.md, `zloam ros-lidar`, or a bag of them";
}

/// All PandarXT append a sequence number.
std::size_t packet_bytes(int lasers) {
  Header header;
  header.lasers = lasers;
  header.blocks = kBlocksPerPacket;
  header.has_sequence = true;
  return header.packet_bytes();
}

class Hesai final : public Maker {
 public:
  explicit Hesai(DecodingOptions options) : options_(std::move(options)) {
    if (!looks_like_angle_corrections(options_.metadata)) return;
    auto parsed = parse_angle_corrections(options_.metadata);
    if (const auto* error = std::get_if<std::string>(&parsed)) {
      error_ = "as a Hesai sensor's angle corrections: " + *error;
      return;
    }
    beams_ = std::get<std::vector<Beam>>(std::move(parsed));
  }

  PacketKind kind(std::span<const std::uint8_t> payload) const override {
    return header_of(payload) ? PacketKind::kData : PacketKind::kForeign;
  }

  std::uint32_t toh_us(std::span<const std::uint8_t> data_packet) const override {
    const std::optional<Header> header = header_of(data_packet);
    if (!header || !header->known() || data_packet.size() != header->packet_bytes()) return 0;
    return tail_of(data_packet.data(), *header).toh_us.value_or(0);
  }

  std::unique_ptr<PacketDecoder> decoder(const FirstPackets& first,
                                         std::vector<std::string>& remarks) const override {
    const std::optional<Header> header = first.empty() ? std::nullopt : header_of(first.back());
    if (!header || !header->known()) {
      return std::make_unique<Undecodable>(unknown_text(header.value_or(Header{})));
    }
    if (beams_.empty()) {
      remarks.push_back(
          "the lasers' angles are those of the sensor's design; with the angle correction file of "
          "this unit in driver.metadata they are its own");
      return std::make_unique<Decoder>(*header, designed_beams(header->lasers), options_);
    }
    if (beams_.size() != static_cast<std::size_t>(header->lasers)) {
      return std::make_unique<Undecodable>(
          options_.metadata_name + " has the angles of " + std::to_string(beams_.size()) +
          " lasers, the packets are of a sensor with " + std::to_string(header->lasers) +
          ": name the angle correction file of this unit in driver.metadata");
    }
    return std::make_unique<Decoder>(*header, beams_, options_);
  }

  std::size_t payload_bytes() const override {
    for (const int lasers : kLaserCounts) {
      if (plain_label(options_.model) == plain_label(label_of(lasers))) return packet_bytes(lasers);
    }
    return beams_.empty() ? 0 : packet_bytes(static_cast<int>(beams_.size()));
  }
  std::string metadata_kind() const override { return "a Hesai sensor's angle corrections (CSV)"; }
  bool described() const override { return !beams_.empty(); }
  std::string metadata_error() const override { return error_; }

 private:
  DecodingOptions options_;
  std::vector<Beam> beams_;
  std::string error_;
};

}  // namespace

std::vector<std::string> models() {
  std::vector<std::string> labels;
  labels.reserve(kLaserCounts.size());
  for (const int lasers : kLaserCounts) labels.push_back(label_of(lasers));
  return labels;
}

std::unique_ptr<const Maker> make(const DecodingOptions& options) {
  return std::make_unique<Hesai>(options);
}

}  // namespace zloam::driver::hesai
