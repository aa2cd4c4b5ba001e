#include "driver/ouster/metadata.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver::ouster {
namespace {

using nlohmann::json;

constexpr int kMostPixels = 256;
constexpr int kMostColumns = 8192;
constexpr std::size_t kNmeaBlockBytes = 100;
constexpr std::size_t kImuReadingBytes = 36;
constexpr std::size_t kLegacyImuBytes = 48;
constexpr double kMetresPerMm = 1e-3;

/// Thrown for metadata that can't be used.
struct Unusable : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Finds values by name, at the top level or in any section of the nested layout.
class Reader {
 public:
  explicit Reader(const json& root) : root_(root) {}

  /// nullptr if there is no such value.
  const json* find(const char* name) const {
    for (const char* section :
         {"", "beam_intrinsics", "lidar_intrinsics", "imu_intrinsics", "sensor_info",
          "lidar_data_format", "imu_data_format", "data_format", "config_params"}) {
      const json* in = &root_;
      if (*section != '\0') {
        const auto found = root_.find(section);
        if (found == root_.end() || !found->is_object()) continue;
        in = &*found;
      }
      if (const auto found = in->find(name); found != in->end() && !found->is_null()) {
        return &*found;
      }
    }
    return nullptr;
  }

  const json& needed(const char* name) const {
    const json* found = find(name);
    if (found == nullptr) throw Unusable(std::string("has no ") + name);
    return *found;
  }

  int whole(const char* name, int least, int most) const {
    const json& value = needed(name);
    if (!value.is_number_integer() || value < least || value > most) {
      throw Unusable(std::string(name) + " is no whole number of " + std::to_string(least) +
                     " to " + std::to_string(most));
    }
    return value.get<int>();
  }

  std::string text(const char* name) const {
    const json* found = find(name);
    return found != nullptr && found->is_string() ? found->get<std::string>() : std::string();
  }

  std::vector<double> numbers(const char* name, std::size_t count) const {
    const json& values = needed(name);
    const auto finite = [](const json& v) {
      return v.is_number() && std::abs(v.get<double>()) <= 1e6;
    };
    if (!values.is_array() || values.size() != count ||
        !std::all_of(values.begin(), values.end(), finite)) {
      throw Unusable(std::string(name) + " is no list of " + std::to_string(count) + " numbers");
    }
    return values.get<std::vector<double>>();
  }

  /// A matrix by rows, its translation in millimetres; the identity if it is missing.
  Eigen::Isometry3d transform(const char* name) const {
    if (find(name) == nullptr) return Eigen::Isometry3d::Identity();
    const std::vector<double> m = numbers(name, 16);
    Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
    for (Eigen::Index r = 0; r < 3; ++r) {
      for (Eigen::Index c = 0; c < 3; ++c) {
        transform.linear()(r, c) = m[static_cast<std::size_t>(4 * r + c)];
      }
      transform.translation()(r) = kMetresPerMm * m[static_cast<std::size_t>(4 * r + 3)];
    }
    const Eigen::Matrix3d& R = transform.linear();
    if (!(R * R.transpose()).isIdentity(1e-3) || R.determinant() < 0.0) {
      throw Unusable(std::string(name) + " does not turn");
    }
    return transform;
  }

 private:
  const json& root_;
};

void read_sensor(const Reader& reader, Metadata& metadata) {
  metadata.model = reader.text("prod_line");
  const std::string serial = reader.text("prod_sn");
  std::from_chars(serial.data(), serial.data() + serial.size(), metadata.serial);
  if (const json* id = reader.find("initialization_id");
      id != nullptr && id->is_number_unsigned()) {
    metadata.initialization_id = id->get<std::uint32_t>();
  }
  const std::string order = reader.text("return_order");
  if (order.starts_with("FARTHEST") || order.starts_with("LAST")) {
    metadata.return_order = ReturnOrder::kFarthestFirst;
  } else if (order.starts_with("NEAREST")) {
    metadata.return_order = ReturnOrder::kNearestFirst;
  }
}

void read_profile(const Reader& reader, Metadata& metadata) {
  std::string name = reader.text("udp_profile_lidar");
  if (name.empty()) name = kLegacy;  // firmware before 2.2 had no other profile
  metadata.profile = profile_by_name(name);
  if (metadata.profile == nullptr) {
    throw Unusable("udp_profile_lidar is " + name + ", which is not decoded; decoded are " +
                   known_profiles());
  }
  const std::string header = reader.text("header_type");
  metadata.fusa_header = header.empty() ? name.starts_with("FUSA") : header == "FUSA";
  if (reader.text("udp_profile_imu") == "ACCEL32_GYRO32_NMEA") {
    metadata.imu_readings_per_packet = reader.whole("imu_measurements_per_packet", 1, 1000);
  }
}

/// Frames per second, from a mode such as "1024x10" (columns, frames per second).
double rate_of(const Reader& reader) {
  int columns = 0;
  double rate_hz = 0.0;
  const std::string mode = reader.text("lidar_mode");
  if (std::sscanf(mode.c_str(), "%dx%lf", &columns, &rate_hz) != 2) {
    rate_hz = reader.whole("fps", 1, 100);
  }
  if (!(rate_hz >= 1.0 && rate_hz <= 100.0)) throw Unusable("lidar_mode is " + mode);
  return rate_hz;
}

void read_format(const Reader& reader, Metadata& metadata) {
  metadata.pixels_per_column = reader.whole("pixels_per_column", 1, kMostPixels);
  // Pixels are decoded in groups of four; all sensors have 16 to 128.
  if (metadata.pixels_per_column % 4 != 0) throw Unusable("pixels_per_column is no multiple of 4");
  metadata.columns_per_frame = reader.whole("columns_per_frame", 16, kMostColumns);
  metadata.columns_per_packet = reader.whole("columns_per_packet", 1, kMostGroups);
  metadata.frames_per_s = rate_of(reader);
  metadata.last_column = metadata.columns_per_frame - 1;
  if (reader.find("column_window") == nullptr) return;
  const std::vector<double> window = reader.numbers("column_window", 2);
  for (const double column : window) {
    if (column < 0.0 || column >= metadata.columns_per_frame) {
      throw Unusable("column_window is beyond columns_per_frame");
    }
  }
  metadata.first_column = static_cast<int>(window[0]);
  metadata.last_column = static_cast<int>(window[1]);
}

void read_beams(const Reader& reader, Metadata& metadata) {
  const auto pixels = static_cast<std::size_t>(metadata.pixels_per_column);
  metadata.altitude_deg = reader.numbers("beam_altitude_angles", pixels);
  metadata.azimuth_deg = reader.numbers("beam_azimuth_angles", pixels);
  if (reader.find("beam_to_lidar_transform") != nullptr) {
    const Eigen::Vector3d origin_m = reader.transform("beam_to_lidar_transform").translation();
    metadata.beam_origin_x_m = origin_m.x();
    metadata.beam_origin_z_m = origin_m.z();
  } else if (const json* origin = reader.find("lidar_origin_to_beam_origin_mm");
             origin != nullptr && origin->is_number()) {
    metadata.beam_origin_x_m = kMetresPerMm * origin->get<double>();
  }
  metadata.T_sensor_lidar = reader.transform("lidar_to_sensor_transform");
  metadata.T_sensor_imu = reader.transform("imu_to_sensor_transform");
}

}  // namespace

std::size_t Metadata::column_bytes() const {
  const auto pixels = static_cast<std::size_t>(pixels_per_column) * profile->pixel_bytes;
  return framing().column_header + pixels + framing().column_footer;
}

std::size_t Metadata::packet_bytes() const {
  return framing().packet_header + static_cast<std::size_t>(columns_per_packet) * column_bytes() +
         framing().packet_footer;
}

std::size_t Metadata::imu_packet_bytes() const {
  if (imu_readings_per_packet == 0) return kLegacyImuBytes;
  return kConfigurableFraming.packet_header + kNmeaBlockBytes +
         static_cast<std::size_t>(imu_readings_per_packet) * kImuReadingBytes +
         kConfigurableFraming.packet_footer;
}

bool Metadata::sees(int column) const {
  return first_column <= last_column ? column >= first_column && column <= last_column
                                     : column >= first_column || column <= last_column;
}

std::variant<Metadata, std::string> parse_metadata(const std::string& text) {
  const json root = json::parse(text, nullptr, false);
  if (!root.is_object()) return "is no JSON object";
  const Reader reader(root);
  Metadata metadata;
  try {
    read_sensor(reader, metadata);
    read_profile(reader, metadata);
    read_format(reader, metadata);
    read_beams(reader, metadata);
  } catch (const std::exception& error) {
    return std::string(error.what());
  }
  return metadata;
}

}  // namespace zloam::driver::ouster
