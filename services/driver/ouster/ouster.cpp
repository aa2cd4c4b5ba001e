#include "driver/ouster/ouster.hpp"

#include <utility>
#include <variant>

#include "driver/decoder/undecodable.hpp"
#include "driver/ouster/decoder.hpp"
#include "driver/ouster/imu_packet.hpp"
#include "driver/ouster/metadata.hpp"
#include "driver/ouster/packet.hpp"

namespace zloam::driver::ouster {
namespace {

/// An error if driver.returns contradicts the profile, which alone determines the returns per
/// pixel.
std::string returns_error(const DecodingOptions& options, const Profile& profile) {
  if (!options.return_mode || returns_of(*options.return_mode) == profile.returns) return {};
  return "driver.returns asks for packets with " +
         std::to_string(returns_of(*options.return_mode)) +
         " return(s) a pixel, but the sensor's profile " + std::string(profile.name) + " has " +
         std::to_string(profile.returns) +
         "; leave driver.returns at auto, or set another profile in the sensor";
}

class Ouster final : public Maker {
 public:
  explicit Ouster(DecodingOptions options) : options_(std::move(options)) {
    // Other makers' metadata are not JSON; any JSON object is taken for Ouster's.
    const std::size_t first = options_.metadata.find_first_not_of(" \t\r\n");
    if (first == std::string::npos || options_.metadata[first] != '{') return;
    auto parsed = parse_metadata(options_.metadata);
    if (const auto* error = std::get_if<std::string>(&parsed)) {
      error_ = "as an Ouster sensor's metadata: " + *error;
      return;
    }
    auto& metadata = std::get<Metadata>(parsed);
    error_ = returns_error(options_, *metadata.profile);
    if (error_.empty()) metadata_ = std::move(metadata);
  }

  PacketKind kind(std::span<const std::uint8_t> payload) const override {
    const std::size_t size = payload.size();
    if (metadata_ && size == metadata_->packet_bytes()) return PacketKind::kData;
    if (metadata_ && is_imu_packet(payload, *metadata_)) return PacketKind::kImu;
    return looks_like_data(payload) ? PacketKind::kData : PacketKind::kForeign;
  }

  std::uint32_t toh_us(std::span<const std::uint8_t> data_packet) const override {
    if (!metadata_ || data_packet.size() != metadata_->packet_bytes()) return 0;
    const auto stamp = stamp_of(data_packet.data(), PacketLayout(*metadata_));
    return stamp ? ouster::toh_us(stamp->time_ns) : 0;
  }

  std::unique_ptr<PacketDecoder> decoder(const FirstPackets& first,
                                         std::vector<std::string>& /*remarks*/) const override {
    if (metadata_) return std::make_unique<Decoder>(*metadata_, options_);
    std::string text = "the packets (" + std::to_string(first.empty() ? 0 : first.back().size()) +
                       " bytes) are an Ouster sensor's, whose beams and format only its metadata "
                       "tell: name their file in driver.metadata, or put it beside a capture "
                       "(drive.json for drive.pcap); `zloam metadata` fetches it from a sensor";
    if (!error_.empty()) text += ". " + options_.metadata_name + ", " + error_;
    return std::make_unique<Undecodable>(text);
  }

  std::vector<ImuReading> imu(std::span<const std::uint8_t> payload) const override {
    return metadata_ ? parse_imu(payload, *metadata_) : std::vector<ImuReading>();
  }

  std::size_t payload_bytes() const override { return metadata_ ? metadata_->packet_bytes() : 0; }
  std::string metadata_kind() const override { return "an Ouster sensor's metadata (JSON)"; }
  bool described() const override { return metadata_.has_value(); }
  std::string metadata_error() const override { return error_; }

 private:
  DecodingOptions options_;
  std::optional<Metadata> metadata_;
  std::string error_;
};

}  // namespace

std::vector<std::string> models() { return {}; }

std::unique_ptr<const Maker> make(const DecodingOptions& options) {
  return std::make_unique<Ouster>(options);
}

}  // namespace zloam::driver::ouster
