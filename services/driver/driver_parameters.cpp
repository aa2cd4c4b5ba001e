#include "driver/driver_parameters.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>

#include "driver/io/scip_link.hpp"

namespace zloam::driver {
namespace {

using runtime::Effect;

// Slower or faster than this, a pace is a mistake: at 10 Hz a sweep in 100 s, or ten thousand a
// second.
constexpr double kLeastRate = 1e-3;
constexpr double kMostRate = 1e3;

/// A decimal number and nothing else; the C library would also take blanks and hexadecimal digits.
std::optional<double> decimal(const std::string& text) {
  double value = 0.0;
  const char* const end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc{} || rest != end || !std::isfinite(value)) return std::nullopt;
  return value;
}

std::string rate_error(const std::string& rate) {
  if (rate == "max" || rate == "realtime") return {};
  const std::optional<double> factor = decimal(rate);
  if (factor && *factor >= kLeastRate && *factor <= kMostRate) return {};
  return "is none of max, realtime, or a factor of 0.001 to 1000 such as 0.5";
}

std::optional<ReturnMode> forced_mode(ReturnChoice choice) {
  switch (choice) {
    case ReturnChoice::kStrongest:
      return ReturnMode::kStrongest;
    case ReturnChoice::kLast:
      return ReturnMode::kLast;
    case ReturnChoice::kDual:
      return ReturnMode::kDual;
    default:
      return std::nullopt;
  }
}

/// The text of a SourceError thrown by the action; empty if none is thrown.
std::string error_of(const std::function<void()>& action) {
  try {
    action();
    return {};
  } catch (const SourceError& error) {
    return error.what();
  }
}

void choose_clock(const DriverConfig& config, AssemblerConfig& assembler) {
  const bool no_receive_times = config.source == SourceKind::kBin;
  switch (config.clock) {
    case ClockChoice::kUtc:
      assembler.clock_mode = ClockMode::kUtc;
      assembler.clock_source =
          no_receive_times ? ClockSource::kSensorFreeRunning : ClockSource::kSensorGps;
      return;
    case ClockChoice::kFree:
      assembler.clock_mode = ClockMode::kFreeRunning;
      assembler.clock_source = ClockSource::kSensorFreeRunning;
      return;
    default:
      assembler.clock_mode = no_receive_times ? ClockMode::kFreeRunning : ClockMode::kReceive;
      assembler.clock_source =
          config.source == SourceKind::kPcap || config.source == SourceKind::kRecording
              ? ClockSource::kCapture
          : no_receive_times ? ClockSource::kSensorFreeRunning
                             : ClockSource::kHost;
  }
}

void bind_source(runtime::Parameters& p, DriverConfig& c) {
  p.add("driver.source", &c.source,
        {{"udp", SourceKind::kUdp},
         {"pcap", SourceKind::kPcap},
         {"bin", SourceKind::kBin},
         {"kitti", SourceKind::kKitti},
         {"scans", SourceKind::kScans},
         {"recording", SourceKind::kRecording},
         {"zenoh", SourceKind::kZenoh},
         {"scip", SourceKind::kScip},
         {"scip_log", SourceKind::kScipLog}},
        "source of packets or scans; scip: a Hokuyo scanner; scip_log: a recorded session of a "
        "Hokuyo scanner",
        Effect::kNone);
  p.add("driver.path", &c.path,
        "file or folder of a recorded source; for scip: tcp://host:port (UTM-30LX-EW: port 10940), "
        "or a serial device such as /dev/ttyACM0",
        Effect::kNone);
  p.add("driver.topic", &c.topic,
        "bag: topic of the clouds or packets; empty: the only one in the bag", Effect::kNone);
  p.add("driver.time_field", &c.time_field,
        "bag: field of a cloud that contains the points' times; empty: recognized by its name",
        Effect::kNone);
  p.add("driver.reader", &c.reader,
        "program that reads bags as `zloam recording` does; a path, or a name on the PATH",
        Effect::kNone);
  p.add("driver.rate", &c.rate, "pace of a replay: max, realtime, or a factor", Effect::kNone);
  p.add("driver.bind_address", &c.udp.bind_address, "local address that receives packets",
        Effect::kNone);
  p.add("driver.port", &c.udp.data_port, {0, 65535}, "",
        "UDP port of data packets; ignored in captures", Effect::kNone);
  p.add("driver.position_port", &c.udp.position_port, {0, 65535}, "",
        "UDP port of position and IMU packets", Effect::kNone);
  p.add("driver.receive_buffer_bytes", &c.udp.receive_buffer_bytes, {65536, 1 << 28}, "bytes",
        "kernel's receive buffer", Effect::kNone);
  p.add("driver.sensor_address", &c.sensor_address,
        "accept packets from this sender only; empty: from the first sender seen");
  p.add("driver.multicast_group", &c.udp.multicast_group,
        "IPv4 multicast group to join; empty: unicast and broadcast", Effect::kNone);
  p.add("driver.quiet_s", &c.quiet_s, {0.1, 3600.0}, "s",
        "live: warn after this long without packets, or without a sweep (then at least 3 s)",
        Effect::kNone);
}

void check_addresses(runtime::Parameters& p, const DriverConfig& c) {
  p.check("driver.sensor_address",
          [&c] { return error_of([&] { parse_ipv4(c.sensor_address); }); });
  p.check("driver.bind_address",
          [&c] { return error_of([&] { parse_ipv4(c.udp.bind_address); }); });
  p.check("driver.multicast_group", [&c]() -> std::string {
    const std::string& group = c.udp.multicast_group;
    if (std::string error = error_of([&] { parse_ipv4(group); }); !error.empty()) return error;
    const bool is_group = group.empty() || parse_ipv4(group) >> 28 == 14;
    return is_group ? "" : '"' + group + "\" is no multicast group of 224.0.0.0 to 239.255.255.255";
  });
  p.check("driver.position_port",
          [&c]() -> std::string {
            const bool same = c.udp.position_port == c.udp.data_port && c.udp.data_port != 0;
            return same && c.source == SourceKind::kUdp ? "must differ from driver.port" : "";
          },
          {"driver.port"});
}

void bind_decoding(runtime::Parameters& p, DriverConfig& c) {
  std::vector<std::string> models = known_models();
  models.insert(models.begin(), "auto");
  p.add("driver.model", &c.model, models, "model of the sensor; auto: from the packets");
  p.add("driver.metadata", &c.metadata,
        "file with the sensor's description of its beams and packets (`zloam metadata` fetches "
        "it), or the mount file of a scanner on a motor (`zloam calibrate`); empty: the .json "
        "beside a capture",
        Effect::kNone);
  p.add("driver.returns", &c.returns,
        {{"auto", ReturnChoice::kAuto},
         {"strongest", ReturnChoice::kStrongest},
         {"last", ReturnChoice::kLast},
         {"dual", ReturnChoice::kDual}},
        "return mode; auto: from the packets");
  p.add("driver.dual_returns", &c.dual_returns,
        {{"strongest", DualReturns::kStrongest},
         {"last", DualReturns::kLast},
         {"both", DualReturns::kBoth},
         {"tagged", DualReturns::kTagged}},
        "returns used of a firing with two: one of them, both without distinction, or both with "
        "their types");
  p.add("driver.seam_azimuth_deg", &c.seam_azimuth_deg, {0.0, 360.0}, "deg",
        "azimuth at which sweeps are cut, clockwise from the front");
  p.add("driver.reorder_packets", &c.reorder_packets, {0, 64}, "packets",
        "packets buffered at a gap to reorder late arrivals");
  p.add("driver.clock", &c.clock,
        {{"auto", ClockChoice::kAuto},
         {"receive", ClockChoice::kReceive},
         {"utc", ClockChoice::kUtc},
         {"free", ClockChoice::kFree}},
        "time base; auto: receive or capture times; utc: the sensor has a locked GPS; free: the "
        "sensor's own clock");
  p.add("driver.stamp_offset_us", &c.stamp_offset_us, {-1e6, 1e6}, "us",
        "offset added to stamps, e.g. of a sensor that stamps a packet's last firing; of a scanner "
        "on a motor only where receive times align its clock");
}

void bind_limits(runtime::Parameters& p, DriverConfig& c) {
  p.add("driver.min_range_m", &c.min_range_m, {0.0, 300.0}, "m",
        "minimum range; nearer returns are dropped");
  p.add("driver.max_range_m", &c.max_range_m, {0.1, 1000.0}, "m",
        "maximum range; farther returns are dropped");
  p.add(
      "driver.azimuth_mask_deg", &c.azimuth_mask_deg,
      "masked sectors: from, to, from, to ... in degrees clockwise from the sensor's front; [350, "
      "10] includes the front");
  p.add("driver.body_box_min_m", &c.body_box_min_m, {-100.0, 100.0}, "m",
        "lower corner of the robot's body in base_link; points inside are dropped");
  p.add("driver.body_box_max_m", &c.body_box_max_m, {-100.0, 100.0}, "m",
        "upper corner of the robot's body in base_link; no box if both corners are zero");
  p.check("driver.body_box_max_m",
          [&c]() -> std::string {
            if (c.body_box_min_m.isZero(0.0) && c.body_box_max_m.isZero(0.0)) return "";
            const bool above = (c.body_box_min_m.array() < c.body_box_max_m.array()).all();
            return above ? "" : "must be above driver.body_box_min_m in x, y and z";
          },
          {"driver.body_box_min_m"});
}

void bind_scans(runtime::Parameters& p, DriverConfig& c) {
  p.add("driver.time_model", &c.scan.model, kTimeModels,
        "scans without point times: direction of rotation, from which the times follow; or "
        "deskewed, if all points are moved to one instant");
  // Sweeps have their period and their points' times with 32 bits in ns (LONGEST_NS in sweeps.py).
  p.add("driver.scan_period_s", &c.scan.period_s, {0.01, 3.9}, "s",
        "period of one revolution in scans without point times");
  p.add("driver.scan_seam_deg", &c.scan.seam_deg, {-360.0, 360.0}, "deg",
        "azimuth at which a revolution begins in scans without point times, counter-clockwise from "
        "the front");
}

bool has_packets(SourceKind source) {
  return source == SourceKind::kUdp || source == SourceKind::kPcap || source == SourceKind::kBin ||
         source == SourceKind::kRecording || source == SourceKind::kZenoh;
}

void bind_imu(runtime::Parameters& p, DriverConfig& c) {
  p.add("driver.imu", &c.imu,
        {{"none", ImuChoice::kNone},
         {"file", ImuChoice::kFile},
         {"zenoh", ImuChoice::kZenoh},
         {"sensor", ImuChoice::kSensor}},
        "source of the IMU readings; file: driver.imu_path (replay); zenoh: the key imu/<sensor> "
        "(live); sensor: the lidar's own packets, or a topic of the bag");
  p.add(
      "driver.imu_path", &c.imu_path,
      "file of IMU readings with a header: t_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2",
      Effect::kNone);
  p.add("driver.imu_topic", &c.imu_topic,
        "bag, with driver.imu: sensor: topic of the IMU readings; empty: the only one in the bag",
        Effect::kNone);
  p.add("driver.imu_delay_ms", &c.imu_delay_ms, {-1000.0, 1000.0}, "ms",
        "delay of the IMU's stamps against the lidar's; it is subtracted");
  p.check("driver.imu", [&c]() -> std::string {
    if (c.imu == ImuChoice::kFile && is_live(c.source)) {
      return "is file, but driver.source is live";
    }
    if (c.imu == ImuChoice::kZenoh && !is_live(c.source)) {
      return "is zenoh, but driver.source is a file or folder: say file, and driver.imu_path";
    }
    if (c.imu == ImuChoice::kSensor && !has_packets(c.source)) {
      return "is sensor, but driver.source has no packets";
    }
    return "";
  });
  p.check("driver.imu_path",
          [&c]() -> std::string {
            const bool lacks = c.imu == ImuChoice::kFile && c.imu_path.empty();
            return lacks ? "is empty, but driver.imu is file" : "";
          },
          {"driver.imu"});
}

}  // namespace

bool is_live(SourceKind source) {
  return source == SourceKind::kUdp || source == SourceKind::kZenoh || source == SourceKind::kScip;
}

std::optional<double> rate_factor(const std::string& rate) {
  if (rate == "max") return std::nullopt;
  if (rate == "realtime") return 1.0;
  return decimal(rate);
}

void bind(runtime::Parameters& p, DriverConfig& c) {
  bind_source(p, c);
  check_addresses(p, c);
  bind_decoding(p, c);
  bind_limits(p, c);
  bind_scans(p, c);
  bind_imu(p, c);
  p.check("driver.rate", [&c] { return rate_error(c.rate); });
  p.check("driver.path",
          [&c]() -> std::string {
            if (c.source == SourceKind::kScip) return device_error(c.path);
            const bool lacks = !is_live(c.source) && c.path.empty();
            return lacks ? "is empty, but driver.source is a file or folder" : "";
          },
          {"driver.source"});
  p.check("driver.time_model",
          [&c]() -> std::string {
            if (c.source != SourceKind::kKitti || c.scan.model != TimeModel::kNone) return "";
            return "is none, but such scans have no point times: say clockwise, "
                   "counter_clockwise or deskewed";
          },
          {"driver.source"});
  p.check("driver.azimuth_mask_deg",
          [&c] { return error_of([&] { azimuth_sectors(c.azimuth_mask_deg); }); });
  p.check("driver.max_range_m",
          [&c]() -> std::string {
            return c.max_range_m > c.min_range_m ? "" : "is not above driver.min_range_m";
          },
          {"driver.min_range_m"});
}

namespace {

/// Whether the sectors leave no direction: the gap behind each one's end lies in another one.
bool hides_all(const std::vector<AzimuthSector>& sectors) {
  return !sectors.empty() && std::all_of(sectors.begin(), sectors.end(), [&](const auto& sector) {
    const double beyond_deg = std::fmod(std::nextafter(sector.to_deg, 1e3), 360.0);
    return std::any_of(sectors.begin(), sectors.end(),
                       [&](const auto& other) { return other.contains(beyond_deg); });
  });
}

}  // namespace

std::vector<AzimuthSector> azimuth_sectors(const std::vector<std::string>& texts) {
  if (texts.size() % 2 != 0) throw SourceError("has an odd number of values; pairs from, to");
  std::vector<double> values_deg;
  for (const std::string& text : texts) {
    const std::optional<double> value_deg = decimal(text);
    if (!value_deg || *value_deg < 0.0 || *value_deg > 360.0) {
      throw SourceError("\"" + text + "\" is no angle of 0 to 360 degrees");
    }
    values_deg.push_back(*value_deg);
  }
  std::vector<AzimuthSector> sectors;
  for (std::size_t i = 0; i < values_deg.size(); i += 2) {
    sectors.push_back({values_deg[i], values_deg[i + 1]});
  }
  if (hides_all(sectors)) throw SourceError("hides every direction: no point would be left");
  return sectors;
}

PointLimits point_limits(const DriverConfig& config, const Pose& T_base_lidar) {
  return {config.min_range_m, config.max_range_m,
          MaskConfig{azimuth_sectors(config.azimuth_mask_deg), config.body_box_min_m,
                     config.body_box_max_m, T_base_lidar}};
}

ScipSourceConfig scip_source_config(const DriverConfig& config, const Pose& T_base_lidar) {
  const PointLimits limits = point_limits(config, T_base_lidar);
  ScipSourceConfig source = read_mount_file(config.metadata);
  spinning::SpinningConfig& spinning = source.spinning;
  source.client.stamp_offset_ns = std::llround(1e3 * config.stamp_offset_us);
  spinning.min_range_m = limits.min_range_m;
  spinning.max_range_m = limits.max_range_m;
  spinning.mask = limits.mask;
  spinning.clock_source =
      config.source == SourceKind::kScip ? ClockSource::kHost : ClockSource::kCapture;
  return source;
}

PacketStreamConfig packet_stream_config(const DriverConfig& config,
                                        const runtime::SharedConfig& shared) {
  const PointLimits limits = point_limits(config, shared.mounting.T_base_lidar());
  PacketStreamConfig stream;
  DecodingOptions& decoding = stream.decoding;
  if (config.model != "auto") decoding.model = config.model;
  decoding.declared_model = shared.sensor.model;
  decoding.return_mode = forced_mode(config.returns);
  decoding.dual_returns = config.dual_returns;
  decoding.min_range_m = limits.min_range_m;
  decoding.max_range_m = limits.max_range_m;
  decoding.vertical_offsets = config.vertical_offsets;
  stream.assembler.mask = limits.mask;
  stream.assembler.seam_azimuth_deg = config.seam_azimuth_deg;
  stream.assembler.guard_ns = std::llround(1e9 * config.guard_s);
  stream.assembler.reorder_packets = config.reorder_packets;
  stream.assembler.stamp_offset_ns = std::llround(1e3 * config.stamp_offset_us);
  choose_clock(config, stream.assembler);
  // A socket receives on its own port only; in a capture the payload decides, whatever its port.
  stream.port = config.source == SourceKind::kUdp ? config.udp.data_port : 0;
  stream.sender = parse_ipv4(config.sensor_address);
  return stream;
}

}  // namespace zloam::driver
