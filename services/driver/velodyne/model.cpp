#include "driver/velodyne/model.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace zloam::driver::velodyne {
namespace {

constexpr int kChannelsPerBlock = 32;

// Vertical offset in mm by laser, 0 to 15 (manual p. 54; rows 0 to 6 by antisymmetry).
constexpr std::array<double, 16> kVlp16OffsetMm = {11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1,
                                                   5.1,  -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2};
constexpr std::array<double, 16> kHiResOffsetMm = {7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7,
                                                   3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4};

// Vertical offset in mm by ring, 0 to 31.
constexpr std::array<double, 32> kHdl32eOffsetMm = {
    17.17, 16.27, 15.40, 14.54, 13.71, 12.89, 12.09, 11.31, 10.54, 9.78, 9.04,
    8.30,  7.58,  6.86,  6.15,  5.45,  4.76,  4.07,  3.38,  2.70,  2.02, 1.35,
    0.67,  0.00,  -0.67, -1.35, -2.02, -2.70, -3.38, -4.07, -4.76, -5.45};

struct Beam {
  double azimuth_correction_deg;
  double elevation_deg;
};

constexpr std::array<Beam, 32> kVlp32cBeams = {{
    {-1.4, -25.000}, {+4.2, -1.000}, {-1.4, -1.667}, {+1.4, -15.639}, {-1.4, -11.310},
    {+1.4, 0.000},   {-4.2, -0.667}, {+1.4, -8.843}, {-1.4, -7.254},  {+4.2, +0.333},
    {-1.4, -0.333},  {+1.4, -6.148}, {-4.2, -5.333}, {+1.4, +1.333},  {-4.2, +0.667},
    {+1.4, -4.000},  {-1.4, -4.667}, {+4.2, +1.667}, {-1.4, +1.000},  {+4.2, -3.667},
    {-4.2, -3.333},  {+1.4, +3.333}, {-1.4, +2.333}, {+1.4, -2.667},  {-1.4, -3.000},
    {+1.4, +7.000},  {-1.4, +4.667}, {+4.2, -2.333}, {-4.2, -2.000},  {+1.4, +15.000},
    {-1.4, +10.333}, {+1.4, -1.333},
}};

// In degrees. Laser l has azimuth correction l mod 8.
constexpr std::array<double, 8> kVls128AzimuthDeg = {-6.354, -4.548, -2.732, -0.911,
                                                     0.911,  2.732,  4.548,  6.354};
constexpr std::array<double, 128> kVls128ElevationDeg = {
    -11.742, -1.990, 3.400,  -5.290,  -0.780, 4.610,  -4.080, 1.310,  -6.500, -1.110,  4.280,
    -4.410,  0.100,  6.480,  -3.200,  2.190,  -3.860, 1.530,  -9.244, -1.770, 2.740,   -5.950,
    -0.560,  4.830,  -2.980, 2.410,   -6.280, -0.890, 3.620,  -5.070, 0.320,  7.580,   -0.340,
    5.180,   -3.640, 1.750,  -25.000, -2.430, 2.960,  -5.730, 0.540,  9.700,  -2.760,  2.630,
    -7.650,  -1.550, 3.840,  -4.850,  3.180,  -5.510, -0.120, 5.730,  -4.300, 1.090,   -16.042,
    -2.210,  4.060,  -4.630, 0.760,   15.000, -3.420, 1.970,  -6.850, -1.330, -5.620,  -0.230,
    5.430,   -3.530, 0.980,  -19.582, -2.320, 3.070,  -4.740, 0.650,  11.750, -2.650,  1.860,
    -7.150,  -1.440, 3.950,  -2.100,  3.290,  -5.400, -0.010, 4.500,  -4.190, 1.200,   -13.565,
    -1.220,  4.170,  -4.520, 0.870,   6.080,  -3.310, 2.080,  -6.650, 1.420,  -10.346, -1.880,
    3.510,   -6.060, -0.670, 4.720,   -3.970, 2.300,  -6.390, -1.000, 4.390,  -5.180,  0.210,
    6.980,   -3.090, 4.980,  -3.750,  1.640,  -8.352, -2.540, 2.850,  -5.840, -0.450,  8.430,
    -2.870,  2.520,  -6.170, -1.660,  3.730,  -4.960, 0.430};

// Lasers of the 16- and 32-beam Pucks alternate between the lower and the upper half of the fan.
constexpr int interleaved_ring(int laser, int lasers) {
  return laser % 2 == 0 ? laser / 2 : lasers / 2 + laser / 2;
}

double offset_by_focal_length_m(double focal_mm, double elevation_deg) {
  return 1e-3 * focal_mm * std::tan(-elevation_deg * std::numbers::pi / 180.0);
}

// A block has two firing sequences of 16 lasers: 2.304 us per laser, 55.296 us per sequence.
std::vector<Channel> sixteen_beam_channels(double lowest_deg, double step_deg,
                                           const std::array<double, 16>& offset_mm) {
  std::vector<Channel> channels;
  for (int c = 0; c < kChannelsPerBlock; ++c) {
    const int firing = c / 16;
    const int laser = c % 16;
    const int ring = interleaved_ring(laser, 16);
    channels.push_back({.elevation_deg = lowest_deg + step_deg * ring,
                        .azimuth_correction_deg = 0.0,
                        .vertical_offset_m = 1e-3 * offset_mm[laser],
                        .time_ns = 55296.0 * firing + 2304.0 * laser,
                        .ring = static_cast<std::uint16_t>(ring),
                        .column = static_cast<std::uint16_t>(firing)});
  }
  return channels;
}

std::vector<Channel> hdl32e_channels() {
  std::vector<Channel> channels;
  for (int c = 0; c < kChannelsPerBlock; ++c) {
    const int ring = interleaved_ring(c, 32);
    // The angles are thirds of a degree, but published, and used by all decoders, with two
    // decimals.
    const double elevation_deg = std::round(100.0 * (-92.0 + 4.0 * ring) / 3.0) / 100.0;
    channels.push_back({.elevation_deg = elevation_deg,
                        .azimuth_correction_deg = 0.0,
                        .vertical_offset_m = 1e-3 * kHdl32eOffsetMm[ring],
                        .time_ns = 1152.0 * c,
                        .ring = static_cast<std::uint16_t>(ring),
                        .column = 0});
  }
  return channels;
}

std::uint16_t rank_by_elevation(const std::vector<Channel>& channels, double elevation_deg) {
  return static_cast<std::uint16_t>(
      std::count_if(channels.begin(), channels.end(),
                    [&](const Channel& c) { return c.elevation_deg < elevation_deg; }));
}

// Lasers fire in pairs, one pair every 2.304 us.
std::vector<Channel> vlp32c_channels() {
  std::vector<Channel> channels;
  for (int c = 0; c < kChannelsPerBlock; ++c) {
    const Beam& beam = kVlp32cBeams[c];
    const int pair = c / 2;
    channels.push_back({.elevation_deg = beam.elevation_deg,
                        .azimuth_correction_deg = beam.azimuth_correction_deg,
                        .vertical_offset_m = offset_by_focal_length_m(42.4, beam.elevation_deg),
                        .time_ns = 2304.0 * pair,
                        .ring = 0,
                        .column = 0});
  }
  for (Channel& channel : channels) {
    channel.ring = rank_by_elevation(channels, channel.elevation_deg);
  }
  return channels;
}

// Eight lasers fire together. Two slots without firing follow the eighth and the last firing.
constexpr double kVls128SlotNs = 2890.0;
constexpr int kVls128Slots = 20;

std::vector<Channel> vls128_channels() {
  std::vector<Channel> channels;
  for (int laser = 0; laser < 128; ++laser) {
    const double elevation_deg = kVls128ElevationDeg[laser];
    const int firing = laser / 8;
    const int slot = firing + 2 * (firing / 8);
    channels.push_back({.elevation_deg = elevation_deg,
                        .azimuth_correction_deg = kVls128AzimuthDeg[laser % 8],
                        .vertical_offset_m = offset_by_focal_length_m(58.63, elevation_deg),
                        .time_ns = kVls128SlotNs * slot,
                        .ring = 0,
                        .column = 0});
  }
  for (Channel& channel : channels) {
    channel.ring = rank_by_elevation(channels, channel.elevation_deg);
  }
  return channels;
}

std::vector<ModelTable> build_tables() {
  std::vector<ModelTable> tables;
  tables.push_back({Model::kVlp16,
                    "vlp16",
                    "VLP-16",
                    {0x22, 0x22},
                    16,
                    0.002,
                    110592.0,
                    2,
                    1,
                    sixteen_beam_channels(-15.0, 2.0, kVlp16OffsetMm)});
  tables.push_back({Model::kPuckHiRes,
                    "puck-hires",
                    "Puck Hi-Res",
                    {0x24, 0x24},
                    16,
                    0.002,
                    110592.0,
                    2,
                    1,
                    sixteen_beam_channels(-10.0, 4.0 / 3.0, kHiResOffsetMm)});
  tables.push_back({Model::kHdl32e,
                    "hdl32e",
                    "HDL-32E",
                    {0x21, 0x21},
                    32,
                    0.002,
                    46080.0,
                    1,
                    1,
                    hdl32e_channels()});
  tables.push_back({Model::kVlp32c,
                    "vlp32c",
                    "VLP-32C",
                    {0x28, 0x28},
                    32,
                    0.004,
                    55296.0,
                    1,
                    1,
                    vlp32c_channels()});
  tables.push_back({Model::kVls128,
                    "vls128",
                    "VLS-128",
                    {0xA1, 0x63},
                    128,
                    0.004,
                    kVls128Slots * kVls128SlotNs,
                    1,
                    4,
                    vls128_channels(),
                    -7000,
                    true});
  return tables;
}

const std::vector<ModelTable>& tables() {
  static const std::vector<ModelTable> kTables = build_tables();
  return kTables;
}

}  // namespace

const ModelTable& model_table(Model model) {
  return *std::find_if(tables().begin(), tables().end(),
                       [&](const ModelTable& t) { return t.model == model; });
}

std::optional<Model> model_by_name(std::string_view name) {
  for (const ModelTable& table : tables()) {
    if (table.name == name) return table.model;
  }
  return std::nullopt;
}

std::optional<Model> model_by_product_id(std::uint8_t product_id) {
  for (const ModelTable& table : tables()) {
    if (table.product_ids[0] == product_id || table.product_ids[1] == product_id) {
      return table.model;
    }
  }
  return std::nullopt;
}

std::string_view product_label(std::uint8_t product_id) {
  if (const auto model = model_by_product_id(product_id)) return model_table(*model).label;
  switch (product_id) {
    case 0x23:
      return "VLP-32A/B";
    case 0x31:
      return "Velarray";
    default:
      return "unknown";
  }
}

std::vector<std::string> known_model_labels() {
  std::vector<std::string> labels;
  for (const ModelTable& table : tables()) labels.emplace_back(table.label);
  return labels;
}

std::string_view known_model_names() { return "vlp16, puck-hires, hdl32e, vlp32c, vls128"; }

}  // namespace zloam::driver::velodyne
