#include "driver/spinning/mount_file.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <numbers>
#include <optional>
#include <set>
#include <stdexcept>

namespace zloam::driver::spinning {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
// The times of a sweep's points, and its period, are 32-bit nanoseconds: 4.29 s. Its last line lies
// within the rest, also where the scanner is slower than it tells.
constexpr double kLongestSweep_s = 3.9;
// Limit of motor.turn_s and of a profile's turn: the sweeps of one turn are counted in 16 bits.
constexpr int kLongestTurn_s = 30;

/// Roll, pitch, yaw of R = Rz(yaw) * Ry(pitch) * Rx(roll).
Eigen::Vector3d rpy_deg_of(const Pose& pose) {
  const Eigen::Matrix3d R = pose.linear();
  return Eigen::Vector3d(std::atan2(R(2, 1), R(2, 2)),
                         std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0))),
                         std::atan2(R(1, 0), R(0, 0))) /
         kDegree;
}

using Readers = std::map<std::string, std::function<void(const YAML::Node&)>>;

/// Reads a number within bounds; the condition is written so that NaN fails it.
std::function<void(const YAML::Node&)> number(double& into, double least, double most) {
  return [&into, least, most](const YAML::Node& node) {
    const auto value = node.as<double>();
    if (!(value >= least && value <= most)) {
      throw std::invalid_argument("is not within " + std::to_string(least) + " and " +
                                  std::to_string(most));
    }
    into = value;
  };
}

std::function<void(const YAML::Node&)> flag(bool& into) {
  return [&into](const YAML::Node& node) { into = node.as<bool>(); };
}

std::function<void(const YAML::Node&)> vector(Eigen::Vector3d& into) {
  return [&into](const YAML::Node& node) {
    if (!node.IsSequence() || node.size() != 3) {
      throw std::invalid_argument("is not three numbers: [x, y, z]");
    }
    for (std::size_t i = 0; i < 3; ++i) into[static_cast<Eigen::Index>(i)] = node[i].as<double>();
    if (!into.allFinite()) throw std::invalid_argument("is not finite");
  };
}

/// Throws a message that begins with the full name of the key, such as "motor.speed".
[[noreturn]] void object(const std::string& key, const std::string& text) {
  throw std::invalid_argument(key + " " + text);
}

/// A key as in the file, also if it is a list or a section, which is never a known key.
std::string text_of(const YAML::Node& key) {
  if (key.IsScalar()) return key.Scalar();
  std::string text = YAML::Dump(key);
  std::replace(text.begin(), text.end(), '\n', ' ');
  return text;
}

/// Refuses a key's second value, which would replace the first one silently.
void once(std::set<std::string>& seen, const std::string& key) {
  if (!seen.insert(key).second) object(key, "stands here a second time");
}

void read_section(const YAML::Node& section, const std::string& name, const Readers& readers) {
  if (!section.IsNull() && !section.IsMap()) object(name, "is no section with keys");
  std::set<std::string> seen;
  for (const auto& entry : section) {
    const std::string key = text_of(entry.first);
    const auto reader = readers.find(key);
    const std::string whole = std::string(name).append(".").append(key);
    if (reader == readers.end()) object(whole, "is no key of it");
    once(seen, whole);
    try {
      reader->second(entry.second);
    } catch (const YAML::Exception&) {
      object(whole, "is not of the kind that is wanted");
    } catch (const std::invalid_argument& error) {
      object(whole, error.what());
    }
  }
}

YAML::Node parsed(const std::string& text) {
  try {
    return YAML::Load(text);
  } catch (const YAML::Exception& error) {
    throw std::invalid_argument(std::string("is no YAML: ") + error.what());
  }
}

/// motor.profile as written in the file; NaN marks a required key that is missing.
struct ToldProfile {
  double from_s = std::nan("");
  double speed_deg_s = std::nan("");
  double amplitude_deg = 0.0;
  double reversal_s = 0.0;
};

Readers readers_of(ToldProfile& told) {
  return {{"from_s", number(told.from_s, 0.0, 1e10)},
          {"speed_deg_s", number(told.speed_deg_s, 1.0, 36000.0)},
          {"amplitude_deg", number(told.amplitude_deg, 1.0, 3600.0)},
          {"reversal_s", number(told.reversal_s, 0.0, 10.0)}};
}

MotorProfile checked(const ToldProfile& told) {
  if (std::isnan(told.from_s)) object("motor.profile.from_s", "is missing");
  if (std::isnan(told.speed_deg_s)) object("motor.profile.speed_deg_s", "is missing");
  const bool swings = told.amplitude_deg > 0.0;
  if (!swings && told.reversal_s > 0.0) {
    object("motor.profile.reversal_s", "needs the amplitude_deg of a swing");
  }
  if (swings && 0.5 * told.reversal_s * told.speed_deg_s >= 2.0 * told.amplitude_deg) {
    object("motor.profile.reversal_s", "is so long that the motor never comes to its speed");
  }
  const MotorProfile profile{told.from_s, told.speed_deg_s * kDegree, told.amplitude_deg * kDegree,
                             told.reversal_s};
  // A turn of just 30 s may be computed as more by a rounding.
  if (profile.turn_s() > kLongestTurn_s + 1e-9) {
    const std::string most_s = std::to_string(std::lround(kLongestTurn_s));
    object("motor.profile.speed_deg_s", "is so slow that a turn takes more than " + most_s + " s");
  }
  return profile;
}

}  // namespace

void read_mount(const std::string& text, scip::ClientConfig& client, SpinningConfig& spinning) {
  Mount& mount = spinning.mount;
  Eigen::Vector3d xyz_m = Eigen::Vector3d::Zero(), rpy_deg = Eigen::Vector3d::Zero();
  double zero_deg = 0.0, delay_ms = 0.0;
  bool backward = false;
  std::optional<double> turn_s;
  std::optional<ToldProfile> profile;
  const Readers of_scanner = {{"rpy_deg", vector(rpy_deg)},
                              {"xyz_m", vector(xyz_m)},
                              {"from_deg", number(client.from_deg, -180.0, 180.0)},
                              {"to_deg", number(client.to_deg, -180.0, 180.0)},
                              {"intensities", flag(client.intensities)},
                              {"several_echoes", flag(client.several_echoes)},
                              {"sweep_s", number(spinning.sweep_s, 0.02, kLongestSweep_s)}};
  const Readers of_motor = {
      {"axis", vector(mount.axis)},
      {"zero_deg", number(zero_deg, -360.0, 360.0)},
      {"backward", flag(backward)},
      {"delay_ms", number(delay_ms, -1000.0, 1000.0)},
      {"turn_s",
       [&](const YAML::Node& node) { number(turn_s.emplace(), 0.1, kLongestTurn_s)(node); }},
      // Only noted here: its keys are read afterwards, so that errors name them with their full
      // path.
      {"profile", [&](const YAML::Node&) { profile.emplace(); }}};
  const YAML::Node root = parsed(text);
  if (root && !root.IsNull() && !root.IsMap()) {
    throw std::invalid_argument("has no sections scanner and motor");
  }
  std::set<std::string> seen;
  for (const auto& entry : root) {
    const std::string name = text_of(entry.first);
    if (name != "scanner" && name != "motor") throw std::invalid_argument(name + " is no section");
    once(seen, name);
    read_section(entry.second, name, name == "scanner" ? of_scanner : of_motor);
  }
  if (!(mount.axis.norm() > 0.0)) throw std::invalid_argument("motor.axis has no length");
  if (client.to_deg <= client.from_deg) {
    throw std::invalid_argument("scanner.to_deg is not above scanner.from_deg");
  }
  if (profile) {
    read_section(root["motor"]["profile"], "motor.profile", readers_of(*profile));
    if (turn_s) object("motor.turn_s", "is told by motor.profile: leave it out");
    spinning.profile = checked(*profile);
    turn_s = spinning.profile->turn_s();
  }
  spinning.turn_s = turn_s.value_or(spinning.turn_s);
  mount.axis.normalize();
  mount.T_motor_scanner = pose_from_xyz_rpy_deg(xyz_m, rpy_deg);
  mount.zero_rad = zero_deg * kDegree;
  mount.direction = backward ? -1.0 : 1.0;
  mount.angle_delay_ns = std::llround(1e6 * delay_ms);
}

std::string mount_text(const scip::ClientConfig& client, const SpinningConfig& spinning) {
  const Mount& mount = spinning.mount;
  const Eigen::Vector3d rpy_deg = rpy_deg_of(mount.T_motor_scanner);
  const Eigen::Vector3d xyz_m = mount.T_motor_scanner.translation();
  const auto word = [](bool on) { return on ? "true" : "false"; };
  std::array<char, 1024> text{};
  std::snprintf(text.data(), text.size(),
                "scanner:\n  rpy_deg: [%.4f, %.4f, %.4f]\n  xyz_m: [%.4f, %.4f, %.4f]\n"
                "  from_deg: %.9g\n  to_deg: %.9g\n  intensities: %s\n  several_echoes: %s\n"
                "  sweep_s: %.9g\nmotor:\n  axis: [%.9g, %.9g, %.9g]\n  zero_deg: %.9g\n"
                "  backward: %s\n  delay_ms: %.3f\n  turn_s: %.9g\n",
                rpy_deg.x(), rpy_deg.y(), rpy_deg.z(), xyz_m.x(), xyz_m.y(), xyz_m.z(),
                client.from_deg, client.to_deg, word(client.intensities),
                word(client.several_echoes), spinning.sweep_s, mount.axis.x(), mount.axis.y(),
                mount.axis.z(), mount.zero_rad / kDegree, word(mount.direction < 0.0),
                1e-6 * static_cast<double>(mount.angle_delay_ns), spinning.turn_s);
  return text.data();
}

}  // namespace zloam::driver::spinning
