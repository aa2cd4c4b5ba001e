#pragma once
// Constants of a model: laser tables, firing times, units. Tables: VLP-16 manual (63-9243) p. 54 to
// 62, VLP-32C manual (63-9325) p. 55 to 67, HDL-32E application note 63-9277, VLS-128: beams as in
// the sensor's calibration file, timing as in firmware 5.2.3 (20 slots of 2.89 us).

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace zloam::driver::velodyne {

enum class Model : std::uint8_t { kVlp16, kPuckHiRes, kHdl32e, kVlp32c, kVls128 };

/// One 3-byte cell of a firing group.
struct Channel {
  double elevation_deg;
  /// the beam points to the block's azimuth minus this, degrees clockwise
  double azimuth_correction_deg;
  /// the beam's origin above the data origin; h in z = r sin(elevation) + h
  double vertical_offset_m;
  /// after the group's first firing
  double time_ns;
  /// rank of the laser by ascending elevation, 0 = lowest
  std::uint16_t ring;
  /// firing column within the group
  std::uint16_t column;
};

struct ModelTable {
  Model model;
  /// as written in configurations: vlp16, puck-hires, hdl32e, vlp32c, vls128
  std::string_view name;
  std::string_view label;
  /// factory byte 1205; the second is an alternative or equal to the first
  std::array<std::uint8_t, 2> product_ids;
  std::uint16_t rings;
  double distance_unit_m;
  /// from one azimuth block (or bank of blocks) to the next
  double group_ns;
  std::uint16_t columns_per_group;
  /// blocks of 32 channels that make up one firing group
  int banks;
  /// banks * 32
  std::vector<Channel> channels;
  /// of the group's first firing after the packet's stamp (VLS-128 manual 63-9483)
  std::int64_t first_firing_ns = 0;
  /// the firmware's firing period differs between sensors: group_ns is the newest firmware's, and
  /// the packets' timing has precedence
  bool period_varies = false;
};

/// The table of a model; built once, lives as long as the program.
const ModelTable& model_table(Model model);

/// By the configuration's name; nothing when unknown.
std::optional<Model> model_by_name(std::string_view name);

/// By the packet's product byte; nothing when unknown.
std::optional<Model> model_by_product_id(std::uint8_t product_id);

/// Label of a product byte, also for models that are not decoded; "unknown" otherwise.
std::string_view product_label(std::uint8_t product_id);

/// "vlp16, puck-hires, ...": for messages.
std::string_view known_model_names();

/// "VLP-16", "Puck Hi-Res", ...: all that are decoded.
std::vector<std::string> known_model_labels();

}  // namespace zloam::driver::velodyne
