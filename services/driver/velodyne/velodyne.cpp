#include "driver/velodyne/velodyne.hpp"

#include <cctype>

#include "driver/velodyne/decoder.hpp"
#include "driver/velodyne/model_check.hpp"
#include "driver/velodyne/packet.hpp"
#include "driver/velodyne/position.hpp"

namespace zloam::driver::velodyne {
namespace {

/// "VLP-16", "vlp16" and "Puck Hi-Res" as the names of the tables have them.
std::optional<Model> model_by_label(const std::string& label) {
  std::string plain;
  for (const char c : label) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0) {
      plain.push_back(static_cast<char>(std::tolower(static_cast<unsigned char>(c))));
    }
  }
  if (plain == "puckhires" || plain == "vlp16hires") return Model::kPuckHiRes;
  if (plain == "puck" || plain == "pucklite") return Model::kVlp16;
  return model_by_name(plain);
}

class Velodyne final : public Maker {
 public:
  explicit Velodyne(const DecodingOptions& options)
      : declared_model_(model_by_label(options.declared_model)) {
    config_.model = model_by_label(options.model);
    config_.return_mode = options.return_mode;
    config_.dual_returns = options.dual_returns;
    config_.min_range_m = options.min_range_m;
    config_.max_range_m = options.max_range_m;
    config_.vertical_offsets = options.vertical_offsets;
  }

  PacketKind kind(std::span<const std::uint8_t> payload) const override {
    if (payload.size() == kDataPacketBytes) return PacketKind::kData;
    return payload.size() == kPositionPacketBytes ? PacketKind::kPosition : PacketKind::kForeign;
  }

  std::uint32_t toh_us(std::span<const std::uint8_t> data_packet) const override {
    return read_u32(data_packet.data() + kTimeAt);
  }

  std::size_t packets_to_know() const override { return kTimingPackets; }

  std::unique_ptr<PacketDecoder> decoder(const FirstPackets& first,
                                         std::vector<std::string>& remarks) const override {
    DecoderConfig config = config_;
    if (!config.model) {
      config.model = model_by_timing(first, declared_model_);
      if (config.model) {
        config.says_contradictions = false;
        remarks.push_back("the packets come at the rate of a " +
                          std::string(model_table(*config.model).label) +
                          ", as sensor.model says, but their product byte says " +
                          std::string(product_label(first.front().back())) +
                          ": decoded as sensor.model (set driver.model to decide otherwise)");
      }
    }
    config.group_ns = measured_group_ns(first, config);
    return std::make_unique<Decoder>(config);
  }

  std::optional<PositionPacket> position(std::span<const std::uint8_t> payload) const override {
    return parse_position(payload);
  }

  std::size_t payload_bytes() const override { return kDataPacketBytes; }

 private:
  DecoderConfig config_;
  std::optional<Model> declared_model_;
};

}  // namespace

std::vector<std::string> models() { return known_model_labels(); }

std::unique_ptr<const Maker> make(const DecodingOptions& options) {
  return std::make_unique<Velodyne>(options);
}

}  // namespace zloam::driver::velodyne
