#include "common/messages/build.hpp"

#include <algorithm>
#include <limits>

#include "common/containers/block_size.hpp"
#include "common/messages/convert.hpp"

namespace zloam {
namespace {

using Builder = flatbuffers::FlatBufferBuilder;

// Room for header, trace, covariances and small fields beside the arrays.
constexpr std::size_t kSmall = 4096;

/// Size of the buffer for a message whose arrays have this total size.
std::size_t room_for(std::size_t arrays_bytes) { return block_size(kSmall + arrays_bytes); }

template <class T>
Buffer finish(Builder& b, flatbuffers::Offset<T> root) {
  b.Finish(root, Kind<T>::kIdentifier);
  return b.Release();
}

msg::Vec3 vec(const Eigen::Vector3d& v) { return to_message(v); }

template <class Int>
Int saturated(std::uint32_t value) {
  return static_cast<Int>(std::min<std::uint32_t>(value, std::numeric_limits<Int>::max()));
}

/// The table copies structs at once, so local ones may end with this call.
template <class TableBuilder>
void add_weak(TableBuilder* m, const WeakFields& weak) {
  const msg::Vec3 translation = vec(weak.weak_translation);
  const msg::Vec3 rotation = vec(weak.weak_rotation);
  m->add_degenerate(weak.degenerate);
  m->add_weak_translation(&translation);
  m->add_weak_rotation(&rotation);
  m->add_weak_sigma_measured(weak.sigma_measured);
  m->add_weak_sigma_predicted(weak.sigma_predicted);
}

/// Fields that odometry and mapping both publish with a solved pose.
template <class TableBuilder>
void add_solution(TableBuilder* m, const WeakFields& weak, const SolveFields& solve) {
  add_weak(m, weak);
  m->add_iterations(saturated<std::uint16_t>(solve.iterations));
  m->add_correspondences(solve.correspondences);
  m->add_residual_m(solve.residual_m);
}

}  // namespace

Buffer build(const HeaderFields& header, const SweepFields& f) {
  Builder b(room_for(f.points.size_bytes() + f.columns.size_bytes() + f.imu.size_bytes()));
  const auto points = put_points(b, f.points);
  const auto columns = b.CreateVector(f.columns.data(), f.columns.size());
  const auto imu = put_structs(b, f.imu);
  const auto model = b.CreateString(f.model);
  const auto head = build_header(b, header);
  msg::SweepBuilder m(b);
  m.add_header(head);
  m.add_points(points);
  m.add_columns(columns);
  m.add_period_ns(f.period_ns);
  m.add_rings(f.rings);
  m.add_model(model);
  m.add_return_mode(f.return_mode);
  m.add_clock_source(f.clock_source);
  m.add_complete(f.complete);
  m.add_packets(f.packets);
  m.add_packets_lost(f.packets_lost);
  m.add_imu(imu);
  m.add_imu_incomplete(f.imu_incomplete);
  m.add_deskewed(f.deskewed);
  m.add_health(to_message(f.health));
  m.add_first_packet_toh_us(f.first_packet_toh_us);
  m.add_last_packet_toh_us(f.last_packet_toh_us);
  m.add_packet_period_ns(f.packet_period_ns);
  m.add_host_clock_step_ns(f.host_clock_step_ns);
  m.add_sensor_clock_step_ns(f.sensor_clock_step_ns);
  if (f.slices > 1) m.add_slices(f.slices);
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const FeaturesFields& f) {
  Builder b(room_for(f.sharp.size_bytes() + f.less_sharp.size_bytes() + f.flat.size_bytes() +
                     f.less_flat.size_bytes() + f.imu.size_bytes()));
  const auto imu = put_structs(b, f.imu);
  const auto sharp = put_points(b, f.sharp);
  const auto less_sharp = put_points(b, f.less_sharp);
  const auto flat = put_points(b, f.flat);
  const auto less_flat = put_points(b, f.less_flat);
  const auto head = build_header(b, header);
  const msg::Vec3 rotation = vec(f.removed_rotation);
  const msg::Vec3 shift = vec(f.removed_shift);
  msg::FeaturesBuilder m(b);
  m.add_header(head);
  m.add_period_ns(f.period_ns);
  m.add_rings(f.rings);
  m.add_sharp(sharp);
  m.add_less_sharp(less_sharp);
  m.add_flat(flat);
  m.add_less_flat(less_flat);
  m.add_points_in(f.points_in);
  m.add_points_rejected(f.points_rejected);
  m.add_removed_rotation(&rotation);
  m.add_removed_shift(&shift);
  m.add_deskewed(f.deskewed);
  m.add_health(to_message(f.health));
  m.add_range_noise_m(f.range_noise_m);
  m.add_imu(imu);
  if (f.slices > 1) m.add_slices(f.slices);
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const OdometryFields& f) {
  Builder b(kSmall);
  const auto covariance = put_covariance(b, f.covariance);
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_odom_base);
  const msg::Twist twist = twist_message(f.twist_per_s);
  msg::OdometryBuilder m(b);
  m.add_header(head);
  m.add_instant_ns(f.instant_ns);
  m.add_pose_odom_base(&pose);
  m.add_twist(&twist);
  m.add_covariance(covariance);
  add_solution(&m, f.weak, f.solve);
  m.add_health(to_message(f.health));
  m.add_prev_sweep(f.prev_sweep);
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const OdometryFeaturesFields& f) {
  Builder b(room_for(f.edges.size_bytes() + f.planes.size_bytes() + f.inertial_state.size_bytes() +
                     f.state.size_bytes()));
  const auto edges = put_points(b, f.edges);
  const auto planes = put_points(b, f.planes);
  const auto covariance = put_covariance(b, f.covariance);
  const auto state_covariance = put_covariance(b, f.state_covariance);
  flatbuffers::Offset<flatbuffers::Vector<double>> inertial_covariance, inertial_state;
  if (f.inertial) inertial_covariance = put_covariance(b, f.inertial->covariance);
  if (!f.inertial_state.empty()) {
    inertial_state = b.CreateVector(f.inertial_state.data(), f.inertial_state.size());
  }
  flatbuffers::Offset<flatbuffers::Vector<std::uint64_t>> state;
  if (!f.state.empty()) state = b.CreateVector(f.state.data(), f.state.size());
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_odom_base);
  const msg::Twist twist = twist_message(f.twist_per_s);
  const msg::Pose mounting = to_message(f.T_base_lidar);
  msg::OdometryFeaturesBuilder m(b);
  m.add_header(head);
  m.add_instant_ns(f.instant_ns);
  m.add_pose_odom_base(&pose);
  m.add_twist(&twist);
  m.add_covariance(covariance);
  m.add_period_ns(f.period_ns);
  m.add_pose_base_lidar(&mounting);
  m.add_edges(edges);
  m.add_planes(planes);
  m.add_prev_sweep(f.prev_sweep);
  m.add_health(to_message(f.health));
  m.add_degenerate(f.degenerate);
  m.add_range_noise_m(f.range_noise_m);
  m.add_state_covariance(state_covariance);
  m.add_inertial_state(inertial_state);
  m.add_state(state);
  m.add_fit(f.fit);
  if (f.slices > 1) m.add_slices(f.slices);
  if (f.inertial) {
    const msg::Vec3 change = vec(f.inertial->velocity_change_mps);
    const msg::Vec3 turn = vec(f.inertial->turn_rad);
    m.add_inertial_velocity_change(&change);
    m.add_inertial_turn(&turn);
    m.add_inertial_covariance(inertial_covariance);
    m.add_at_rest(f.inertial->at_rest);
  }
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const MapCorrectionFields& f) {
  Builder b(kSmall);
  const auto covariance = put_covariance(b, f.covariance);
  const auto state = b.CreateVector(f.state.data(), f.state.size());
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_map_odom);
  msg::MapCorrectionBuilder m(b);
  m.add_header(head);
  m.add_instant_ns(f.instant_ns);
  m.add_pose_map_odom(&pose);
  m.add_covariance(covariance);
  m.add_health(to_message(f.health));
  m.add_inserted(f.inserted);
  add_solution(&m, f.weak, f.solve);
  m.add_prev_sweep(f.prev_sweep);
  m.add_state(state);
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const MapPoseFields& f) {
  Builder b(kSmall);
  const auto covariance = put_covariance(b, f.covariance);
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_map_base);
  const msg::Twist twist = twist_message(f.twist_per_s);
  msg::MapPoseBuilder m(b);
  m.add_header(head);
  m.add_instant_ns(f.instant_ns);
  m.add_pose_map_base(&pose);
  m.add_twist(&twist);
  m.add_covariance(covariance);
  m.add_correction_sweep(f.correction_sweep);
  m.add_has_correction(f.has_correction);
  m.add_jump(f.jump);
  m.add_health(to_message(f.health));
  add_weak(&m, f.weak);
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const MapTileFields& f) {
  Builder b(room_for(f.points.size_bytes() + f.counts.size_bytes() + f.voxels.size_bytes() +
                     f.leads.size_bytes()));
  const auto points = put_points(b, f.points);
  flatbuffers::Offset<flatbuffers::Vector<std::uint32_t>> counts;
  if (!f.counts.empty()) counts = b.CreateVector(f.counts.data(), f.counts.size());
  flatbuffers::Offset<flatbuffers::Vector<const msg::MapVoxel*>> voxels;
  if (!f.voxels.empty()) voxels = b.CreateVectorOfStructs(f.voxels.data(), f.voxels.size());
  flatbuffers::Offset<flatbuffers::Vector<std::uint32_t>> leads;
  if (!f.leads.empty()) leads = b.CreateVector(f.leads.data(), f.leads.size());
  const auto layer = b.CreateString(f.layer);
  const auto head = build_header(b, header);
  return finish(
      b, msg::CreateMapTile(b, head, layer, f.i, f.j, f.k, f.edge_m, f.version, points, counts,
                            voxels, f.root_voxel_m, f.levels, f.range_noise_m, leads));
}

Buffer build(const HeaderFields& header, const CloudFields& f) {
  Builder b(room_for(f.points.size_bytes()));
  const auto points = put_points(b, f.points);
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_frame_base);
  return finish(b, msg::CreateCloud(b, head, f.instant_ns, points, &pose));
}

Buffer build(const HeaderFields& header, const Submap& s) {
  Builder b(room_for(s.points.size() * (sizeof(MapPoint) + sizeof(std::uint64_t))));
  const auto points = put_points(b, std::span<const MapPoint>(s.points));
  const auto covariance = put_covariance(b, s.step_covariance);
  // Of a map that an earlier version stored, none are known.
  flatbuffers::Offset<flatbuffers::Vector<std::uint64_t>> hits;
  if (s.hits.size() == s.points.size()) hits = b.CreateVector(s.hits);
  std::vector<msg::Vec3> places;
  for (const Eigen::Vector3d& p : s.origins) places.emplace_back(p.x(), p.y(), p.z());
  const auto origins = b.CreateVectorOfStructs(places);
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(s.T_map_submap);
  return finish(
      b, msg::CreateSubmap(b, head, s.first_sweep, s.sweep, s.instant_ns, &pose, covariance,
                           s.step_m, s.connected, static_cast<float>(s.range_noise_m), points,
                           s.before_sweep, hits, origins));
}

Buffer build(const HeaderFields& header, const LoopFields& f) {
  Builder b(kSmall);
  const auto covariance = put_covariance(b, f.covariance);
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_from_to);
  return finish(b, msg::CreateLoop(b, head, f.from_sweep, f.to_sweep, &pose, covariance, f.overlap,
                                   f.residual_m, f.chi2, f.verdict));
}

Buffer build(const HeaderFields& header, const GraphPosesFields& f) {
  Builder b(room_for(f.poses.size_bytes()));
  const auto poses = put_structs(b, f.poses);
  const auto head = build_header(b, header);
  return finish(
      b, msg::CreateGraphPoses(b, head, f.revision, poses, f.loops, f.chi2_before, f.chi2_after));
}

Buffer build(const HeaderFields& header, const PreviewFields& f) {
  Builder b(room_for(f.blocks.size_bytes() + f.octrees.size_bytes()));
  const auto blocks = put_structs(b, f.blocks);
  const auto octrees = b.CreateVector(f.octrees.data(), f.octrees.size());
  const auto head = build_header(b, header);
  const msg::Pose pose = to_message(f.T_map_base.value_or(Pose::Identity()));
  return finish(b, msg::CreatePreview(b, head, f.epoch, f.instant_ns,
                                      f.T_map_base ? &pose : nullptr, to_message(f.health),
                                      f.degenerate, f.block_m, f.map_blocks, blocks, octrees));
}

Buffer build(const HeaderFields& header, const RejectedFields& f) {
  Builder b(room_for(f.points.size_bytes() + f.reasons.size_bytes()));
  const auto points = put_points(b, f.points);
  const auto reasons =
      b.CreateVector(reinterpret_cast<const std::uint8_t*>(f.reasons.data()), f.reasons.size());
  const auto head = build_header(b, header);
  msg::RejectedBuilder m(b);
  m.add_header(head);
  m.add_points(points);
  m.add_reasons(flatbuffers::Offset<flatbuffers::Vector<msg::RejectReason>>(reasons.o));
  return finish(b, m.Finish());
}

Buffer build(const HeaderFields& header, const PacketsFields& f) {
  Builder b(room_for(f.entries.size_bytes() + f.data.size_bytes()));
  const auto entries = put_structs(b, f.entries);
  const auto data = b.CreateVector(f.data.data(), f.data.size());
  const auto model = b.CreateString(f.model);
  const auto head = build_header(b, header);
  return finish(b, msg::CreatePackets(b, head, entries, data, model));
}

Buffer build_angles(const HeaderFields& header, std::span<const msg::AngleReading> readings) {
  Builder b(room_for(readings.size_bytes()));
  const auto list = put_structs(b, readings);
  const auto head = build_header(b, header);
  return finish(b, msg::CreateMotorAngles(b, head, list));
}

Buffer build_imu(const HeaderFields& header, std::span<const msg::ImuSample> samples,
                 msg::ClockSource clock_source) {
  Builder b(room_for(samples.size_bytes()));
  const auto list = put_structs(b, samples);
  const auto head = build_header(b, header);
  return finish(b, msg::CreateImuBatch(b, head, list, clock_source));
}

Buffer build_gnss(const HeaderFields& header, std::span<const GnssFixFields> fixes) {
  Builder b(kSmall);
  std::vector<flatbuffers::Offset<msg::GnssFix>> list;
  list.reserve(fixes.size());
  for (const GnssFixFields& f : fixes) {
    const auto sentence = b.CreateString(f.sentence);
    list.push_back(msg::CreateGnssFix(b, f.received_ns, f.utc_ns, f.latitude_deg, f.longitude_deg,
                                      f.valid, f.pps, sentence));
  }
  const auto items = b.CreateVector(list);
  const auto head = build_header(b, header);
  return finish(b, msg::CreateGnssBatch(b, head, items));
}

Buffer build_path(const HeaderFields& header, std::span<const msg::StampedPose> poses) {
  Builder b(room_for(poses.size_bytes()));
  const auto list = put_structs(b, poses);
  const auto head = build_header(b, header);
  return finish(b, msg::CreatePath(b, head, list));
}

Buffer build(const ProgressFields& f) {
  Builder b;
  const auto instance = b.CreateString(f.instance);
  const auto missing = b.CreateVector(f.missing);
  return finish(
      b, msg::CreateProgress(b, f.run, instance, f.next_sweep, missing, f.seq, f.received_below));
}

Buffer build(const FlowAckFields& f) {
  Builder b;
  const auto sink = b.CreateString(f.sink);
  const auto instance = b.CreateString(f.instance);
  return finish(b, msg::CreateFlowAck(b, f.run, sink, instance, f.done_below, f.seq));
}

Buffer build(const ConfigRevisionFields& f) {
  Builder b;
  const auto stage = b.CreateString(f.stage);
  const auto values = b.CreateString(f.values_json);
  const auto by = b.CreateString(f.by);
  return finish(
      b, msg::CreateConfigRevision(b, stage, f.rev, f.run, f.from_sweep, values, by, f.at_ns));
}

Buffer build_command(const std::string& arguments_json) {
  Builder b;
  return finish(b, msg::CreateCommand(b, b.CreateString(arguments_json)));
}

Buffer build(const CommandReplyFields& f) {
  Builder b;
  const auto message = b.CreateString(f.message);
  const auto results = b.CreateString(f.results_json);
  b.Finish(msg::CreateCommandReply(b, f.ok, message, results), Kind<msg::Command>::kIdentifier);
  return b.Release();
}

}  // namespace zloam
