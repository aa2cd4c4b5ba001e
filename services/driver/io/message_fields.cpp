#include "driver/io/message_fields.hpp"

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
  fields.health = health_of(sweep);
  return fields;
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
