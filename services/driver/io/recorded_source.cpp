#include "driver/io/recorded_source.hpp"

#include "driver/io/metadata_file.hpp"
#include "driver/io/recording.hpp"
#include "driver/io/scan_folder.hpp"

namespace zloam::driver {
namespace {

RecordedSource open_packets(std::unique_ptr<PacketSource> packets, const DriverConfig& config,
                            const PacketStreamConfig& stream) {
  RecordedSource opened{sweeps_of_packets(std::move(packets), stream, 0), {}, {config.path}};
  const bool described = Makers(stream.decoding).metadata_error().empty();
  if (described) opened.files.push_back(stream.decoding.metadata_name);
  return opened;
}

RecordedSource open_bag(const DriverConfig& config, const PacketStreamConfig& stream,
                        const PointLimits& limits) {
  Recording recording =
      open_recording({config.path, config.reader, config.topic, config.imu == ImuChoice::kSensor,
                      config.imu_topic, config.time_field, config.scan});
  return {recording.packets ? sweeps_of_packets(std::move(recording.packets), stream, 0)
                            : sweeps_of_scans(std::move(recording.clouds), limits),
          recording.identity,
          {}};
}

/// The motor's angles come from the file beside the session, unless a motor profile replaces them.
RecordedSource open_session(const DriverConfig& config, const Pose& T_base_lidar) {
  const ScipSourceConfig source = scip_source_config(config, T_base_lidar);
  RecordedSource opened{nullptr, {}, {config.path}};
  std::vector<spinning::AngleReading> readings;
  if (!source.spinning.profile) {
    opened.files.push_back(angles_beside(config.path));
    readings = read_angle_file(opened.files.back());
  }
  if (!config.metadata.empty()) opened.files.push_back(config.metadata);
  opened.sweeps = sweeps_of_session(config.path, readings, source);
  return opened;
}

RecordedSource open_scans(const DriverConfig& config, const PointLimits& limits) {
  auto scans = config.source == SourceKind::kKitti ? open_kitti(config.path, config.scan)
                                                   : open_synth(config.path);
  const std::vector<std::string> files = scans->files();
  return {sweeps_of_scans(std::move(scans), limits), {}, files};
}

}  // namespace

RecordedSource open_recorded(const DriverConfig& config, const runtime::SharedConfig& shared) {
  PacketStreamConfig stream = packet_stream_config(config, shared);
  const PointLimits limits = point_limits(config, shared.mounting.T_base_lidar());
  switch (config.source) {
    case SourceKind::kPcap:
      read_metadata(config.metadata, config.path, stream.decoding);
      return open_packets(open_pcap(config.path), config, stream);
    case SourceKind::kBin:
      read_metadata(config.metadata, "", stream.decoding);
      return open_packets(
          open_payload_file(config.path, Makers(stream.decoding).maker().payload_bytes()), config,
          stream);
    case SourceKind::kRecording:
      read_metadata(config.metadata, "", stream.decoding);
      return open_bag(config, stream, limits);
    case SourceKind::kScipLog:
      return open_session(config, shared.mounting.T_base_lidar());
    default:
      return open_scans(config, limits);
  }
}

}  // namespace zloam::driver
