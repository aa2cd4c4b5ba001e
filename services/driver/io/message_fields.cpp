#include "driver/io/message_fields.hpp"

#include "common/messages/convert.hpp"
#include "schemas/packets_generated.h"
#include "schemas/sweep_generated.h"

namespace zloam::driver {
namespace {

msg::ReturnMode to_message(ReturnMode mode) { return static_cast<msg::ReturnMode>(mode); }
msg::ClockSource to_message(ClockSource source) { return static_cast<msg::ClockSource>(source); }

Health health_of(const DecodedSweep& sweep) {
  if (sweep.points.empty()) return Health::kEmpty;
  return sweep.complete ? Health::kOk : Health::kIncomplete;
}

}  // namespace

SweepFields fields_of(const DecodedSweep& sweep) {
  SweepFields fields;
  fields.points = sweep.points;
  fields.columns = sweep.columns;
  fields.period_ns = sweep.period_ns;
  fields.rings = sweep.rings;
  fields.model = sweep.model;
  fields.return_mode = to_message(sweep.return_mode);
  fields.clock_source = to_message(sweep.clock_source);
  fields.complete = sweep.complete;
  fields.packets = sweep.packets;
  fields.packets_lost = sweep.packets_lost;
  fields.deskewed = sweep.deskewed;
  fields.first_packet_toh_us = sweep.first_packet_toh_us;
  fields.last_packet_toh_us = sweep.last_packet_toh_us;
  fields.packet_period_ns = sweep.packet_period_ns;
  fields.host_clock_step_ns = sweep.host_clock_step_ns;
  fields.sensor_clock_step_ns = sweep.sensor_clock_step_ns;
  fields.slices = sweep.slices;
  fields.health = health_of(sweep);
  return fields;
}

DecodedSweep sweep_of(const msg::Sweep& message) {
  DecodedSweep sweep;
  const PointSpan points = points_of(message.points());
  sweep.points.assign(points.begin(), points.end());
  sweep.columns.assign(sweep.points.size(), 0);
  if (const auto* columns = message.columns()) {
    sweep.columns.assign(columns->begin(), columns->end());
  }
  if (message.header() != nullptr) sweep.stamp_ns = message.header()->stamp_ns();
  sweep.period_ns = message.period_ns();
  sweep.rings = message.rings();
  if (message.model() != nullptr) sweep.model = message.model()->str();
  sweep.return_mode = static_cast<ReturnMode>(message.return_mode());
  sweep.clock_source = static_cast<ClockSource>(message.clock_source());
  sweep.complete = message.complete();
  sweep.packets = message.packets();
  sweep.packets_lost = message.packets_lost();
  sweep.deskewed = message.deskewed();
  sweep.first_packet_toh_us = message.first_packet_toh_us();
  sweep.last_packet_toh_us = message.last_packet_toh_us();
  sweep.packet_period_ns = message.packet_period_ns();
  sweep.host_clock_step_ns = message.host_clock_step_ns();
  sweep.sensor_clock_step_ns = message.sensor_clock_step_ns();
  sweep.slices = std::max<std::uint16_t>(1, message.slices());
  return sweep;
}

GnssFixFields fields_of(const ReceivedPosition& position) {
  GnssFixFields fix;
  fix.received_ns = position.received_ns;
  fix.pps = static_cast<msg::PpsStatus>(position.packet.pps);
  fix.sentence = position.packet.nmea;
  if (const auto rmc = parse_rmc(fix.sentence)) {
    fix.utc_ns = rmc->utc_ns;
    fix.latitude_deg = rmc->latitude_deg;
    fix.longitude_deg = rmc->longitude_deg;
    fix.valid = rmc->valid;
  }
  return fix;
}

}  // namespace zloam::driver
