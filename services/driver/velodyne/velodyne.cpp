#include "driver/velodyne/velodyne.hpp"

#include "driver/decoder/label.hpp"
#include "driver/decoder/undecodable.hpp"
#include "driver/velodyne/decoder.hpp"
#include "driver/velodyne/hdl64e.hpp"
#include "driver/velodyne/model_check.hpp"
#include "driver/velodyne/packet.hpp"
#include "driver/velodyne/position.hpp"

namespace zloam::driver::velodyne {
namespace {

/// Finds the table for a label such as "VLP-16", "vlp16" or "Puck Hi-Res".
std::optional<Model> model_by_label(const std::string& label) {
  const std::string plain = plain_label(label);
  if (plain == "puckhires" || plain == "vlp16hires") return Model::kPuckHiRes;
  if (plain == "puck" || plain == "pucklite") return Model::kVlp16;
  return model_by_name(plain);
}

class Velodyne final : public Maker {
 public:
  explicit Velodyne(const DecodingOptions& options)
      : options_(options),
        hdl64e_(hdl64e_by_label(options.model)),
        declared_model_(model_by_label(options.declared_model)) {
    if (looks_like_calibration(options.metadata)) read_calibration();
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
    if (hdl64e_ || (!config_.model && !first.empty() && looks_like_hdl64e(first.back()))) {
      return hdl64e_decoder();
    }
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
  std::string metadata_kind() const override { return "an HDL-64E's calibration (XML or YAML)"; }
  bool described() const override { return calibration_.has_value(); }
  std::string metadata_error() const override { return error_; }

 private:
  void read_calibration() {
    auto parsed = parse_calibration(options_.metadata);
    if (const auto* error = std::get_if<std::string>(&parsed)) {
      error_ = "as an HDL-64E's calibration: " + *error;
    } else {
      calibration_ = std::get<Calibration>(std::move(parsed));
    }
  }

  std::unique_ptr<PacketDecoder> hdl64e_decoder() const {
    if (hdl64e_ && calibration_) {
      return std::make_unique<Hdl64eDecoder>(*hdl64e_, *calibration_, options_);
    }
    std::string text = "the packets are an HDL-64E's";
    if (!hdl64e_)
      text += "; set driver.model to the edition on its label, HDL-64E S2 or HDL-64E S3";
    if (!calibration_) {
      text +=
          "; each unit has its own calibration: name the file that came with it (db.xml, or the "
          "YAML made of it) in driver.metadata";
    }
    if (!error_.empty()) text += ". " + options_.metadata_name + ", " + error_;
    return std::make_unique<Undecodable>(text);
  }

  DecodingOptions options_;
  const Hdl64eModel* hdl64e_;
  std::optional<Calibration> calibration_;
  std::string error_;
  DecoderConfig config_;
  std::optional<Model> declared_model_;
};

}  // namespace

std::vector<std::string> models() {
  std::vector<std::string> labels = known_model_labels();
  for (const Hdl64eModel& model : kHdl64eModels) labels.emplace_back(model.label);
  return labels;
}

std::unique_ptr<const Maker> make(const DecodingOptions& options) {
  return std::make_unique<Velodyne>(options);
}

}  // namespace zloam::driver::velodyne
