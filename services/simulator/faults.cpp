#include "simulator/faults.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace zloam::simulator {
namespace {

constexpr std::size_t kStampOffset = 1200;
constexpr std::size_t kPositionStampOffset = 198;
constexpr std::int64_t kHourUs = 3'600'000'000;
constexpr std::size_t kBlockBytes = 100;

void shift_stamp(Datagram& datagram, double step_s) {
  const std::size_t offset = datagram.is_data() ? kStampOffset : kPositionStampOffset;
  std::int64_t stamp = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    stamp |= static_cast<std::int64_t>(datagram.payload[offset + i]) << (8 * i);
  }
  stamp = (stamp + std::llround(step_s * 1e6)) % kHourUs;
  stamp = stamp < 0 ? stamp + kHourUs : stamp;
  for (std::size_t i = 0; i < 4; ++i) {
    datagram.payload[offset + i] = static_cast<std::uint8_t>(stamp >> (8 * i));
  }
}

// Shifts the azimuths from a random block on by a random angle. Returns block and angle as the
// fault's detail.
std::string jump_azimuth(Datagram& datagram, Random& random) {
  const std::uint64_t from = 1 + random.bits() % (vlp16::kBlocks - 1);
  const std::uint64_t by = 100 + random.bits() % 35'800;
  for (std::uint64_t block = from; block < vlp16::kBlocks; ++block) {
    const std::size_t at = block * kBlockBytes + 2;
    const auto azimuth =
        static_cast<std::uint64_t>(datagram.payload[at] + 256 * datagram.payload[at + 1]);
    const std::uint64_t off = (azimuth + by) % 36'000;
    datagram.payload[at] = static_cast<std::uint8_t>(off);
    datagram.payload[at + 1] = static_cast<std::uint8_t>(off >> 8);
  }
  return "block " + std::to_string(from) + " by " + std::to_string(by);
}

std::string scatter_noise(Datagram& datagram, Random& random) {
  std::vector<std::size_t> places;
  while (places.size() < 8) {
    const std::size_t at = random.bits() % datagram.payload.size();
    if (std::find(places.begin(), places.end(), at) == places.end()) {
      places.push_back(at);
    }
  }
  std::sort(places.begin(), places.end());
  std::string text = "bytes";
  for (const std::size_t at : places) {
    datagram.payload[at] ^= static_cast<std::uint8_t>(1 + random.bits() % 255);
    text += " " + std::to_string(at);
  }
  return text;
}

}  // namespace

std::vector<std::string> fault_kinds() {
  return {"lost",         "duplicated", "late", "corrupted", "bad_flag",
          "azimuth_jump", "cut",        "gap",  "clock_step"};
}

FaultInjector::FaultInjector(const FaultConfig& config, std::int64_t start_ns)
    : config_(config), start_ns_(start_ns) {
  for (const double part : {config.loss, config.duplication, config.delay, config.corruption,
                            config.bad_flag, config.azimuth_jump, config.wrong_length}) {
    if (!(part >= 0.0 && part <= 1.0)) {
      throw std::invalid_argument("parts of packets must be from 0 to 1");
    }
  }
  if (config.delay_packets < 1) {
    throw std::invalid_argument("delay_packets must be at least 1");
  }
  std::stable_sort(config_.clock_steps.begin(), config_.clock_steps.end(),
                   [](const ClockStep& a, const ClockStep& b) { return a.at_s < b.at_s; });
}

// Faults that depend on the time: clock steps and gaps. False if the datagram falls into a gap.
bool FaultInjector::disturb_time(Datagram& datagram) {
  const double time_s = static_cast<double>(datagram.sent_ns - start_ns_) * 1e-9;
  for (;
       steps_done_ < config_.clock_steps.size() && time_s >= config_.clock_steps[steps_done_].at_s;
       ++steps_done_) {
    const double by_s = config_.clock_steps[steps_done_].by_s;
    step_s_ += by_s;
    log_.push_back({datagram.index + (datagram.is_data() ? 0 : 1), "clock_step",
                    "by " + std::to_string(by_s) + " s"});
  }
  if (step_s_ != 0.0) {
    shift_stamp(datagram, step_s_);
  }
  if (config_.gap_s > 0.0 && time_s >= config_.gap_start_s &&
      time_s < config_.gap_start_s + config_.gap_s) {
    if (datagram.is_data()) {
      log_.push_back({datagram.index, "gap", ""});
    }
    return false;
  }
  return true;
}

// A later packet has been sent: counts it for the packets held back, and sends those that have been
// overtaken often enough.
void FaultInjector::overtake(std::int64_t now_ns, std::vector<Datagram>& out) {
  std::vector<Held> still;
  for (Held& held : held_) {
    if (++held.overtaken < config_.delay_packets) {
      still.push_back(std::move(held));
      continue;
    }
    log_[held.note].detail = "by " + std::to_string(held.overtaken);
    held.datagram.sent_ns = now_ns;
    out.push_back(std::move(held.datagram));
  }
  held_ = std::move(still);
}

void FaultInjector::disturb_bytes(Datagram& datagram, Random& random) {
  const bool corrupted = random.chance(config_.corruption);
  const bool cut = random.chance(config_.wrong_length);
  const bool bad_flag = random.chance(config_.bad_flag);
  const bool jump = random.chance(config_.azimuth_jump);
  const auto note = [&](const char* kind, std::string detail) {
    log_.push_back({datagram.index, kind, std::move(detail)});
  };
  if (bad_flag) {
    const std::size_t block = random.bits() % vlp16::kBlocks;
    datagram.payload[block * kBlockBytes] ^= static_cast<std::uint8_t>(1 + random.bits() % 255);
    note("bad_flag", "block " + std::to_string(block));
  }
  if (jump) {
    note("azimuth_jump", jump_azimuth(datagram, random));
  }
  if (corrupted) {
    note("corrupted", scatter_noise(datagram, random));
  }
  if (cut) {
    datagram.payload.resize(random.bits() % datagram.payload.size());
    note("cut", "to " + std::to_string(datagram.payload.size()));
  }
}

void FaultInjector::pass_one(Datagram datagram, std::vector<Datagram>& out) {
  if (!disturb_time(datagram)) {
    return;
  }
  if (!datagram.is_data()) {
    out.push_back(std::move(datagram));
    return;
  }
  Random random(config_.seed, Stream::kFaults, static_cast<std::uint64_t>(datagram.index));
  const bool lost = random.chance(config_.loss);
  const bool twice = random.chance(config_.duplication);
  const bool late = random.chance(config_.delay);
  if (lost) {
    log_.push_back({datagram.index, "lost", ""});
    return;
  }
  disturb_bytes(datagram, random);
  if (late) {
    held_.push_back({std::move(datagram), 0, log_.size()});
    log_.push_back({held_.back().datagram.index, "late", ""});
    return;
  }
  const std::int64_t now_ns = datagram.sent_ns;
  if (twice) {
    log_.push_back({datagram.index, "duplicated", ""});
    out.push_back(datagram);
  }
  out.push_back(std::move(datagram));
  overtake(now_ns, out);
}

std::vector<Datagram> FaultInjector::pass(std::vector<Datagram> in) {
  std::vector<Datagram> out;
  for (Datagram& datagram : in) {
    pass_one(std::move(datagram), out);
  }
  return out;
}

std::vector<Datagram> FaultInjector::flush() {
  std::vector<Datagram> out;
  for (Held& held : held_) {
    log_[held.note].detail = "by " + std::to_string(held.overtaken);
    if (held.overtaken == 0) {
      log_[held.note].kind.clear();  // no packet overtook it, so it is not late
    }
    out.push_back(std::move(held.datagram));
  }
  held_.clear();
  std::erase_if(log_, [](const Fault& fault) { return fault.kind.empty(); });
  return out;
}

}  // namespace zloam::simulator
