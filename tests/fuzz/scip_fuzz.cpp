// Reads replies of a SCIP device: any bytes must give valid scans and sweeps (check()), or none.
#include <cmath>
#include <cstdlib>
#include <string>

#include "driver/scip/client.hpp"
#include "driver/scip/encoding.hpp"
#include "driver/spinning/sweeps.hpp"

using namespace zloam::driver;

namespace {

constexpr std::int64_t kMs = 1'000'000;

/// Adds the checksum to each line, so that the code behind the checksum test is reached.
std::string mended(std::string_view text) {
  std::string out, line;
  bool echo = true;
  const auto end_line = [&] {
    const bool information = line.size() > 1 && line.back() == ';';
    if (!line.empty() && !echo) {
      line += scip::checksum(information ? line.substr(0, line.size() - 1) : line);
    }
    echo = line.empty();
    out += line + "\n";
    line.clear();
  };
  for (const char c : text) {
    if (c == '\n') {
      end_line();
    } else {
      line += c;
    }
  }
  return out + line;
}

void check(const scip::TimedScan& timed) {
  const scip::ScanRequest& request = timed.scan.request;
  int last = -1;
  for (const scip::Echo& echo : timed.scan.echoes) {
    if (echo.step < request.first_step || echo.step > request.last_step) std::abort();
    if (echo.step < last || echo.number >= scip::kMostEchoes) std::abort();
    last = echo.step;
  }
  if (timed.turns < 0) std::abort();
}

void check(const DecodedSweep& sweep) {
  if (sweep.points.size() != sweep.columns.size()) std::abort();
  for (const zloam::Point& p : sweep.points) {
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) std::abort();
    if (p.ring >= sweep.rings) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::uint8_t flags = data[0];
  std::string text(reinterpret_cast<const char*>(data + 1), size - 1);
  if ((flags & 1) != 0) text = mended(text);
  scip::ClientConfig config;
  config.asks = (flags & 2) != 0;
  config.several_echoes = (flags & 4) != 0;
  scip::Client client(config);
  spinning::SpinningSweeps sweeps({});
  std::int64_t now_ns = 1'700'000'000'000 * kMs;
  client.connected(now_ns);
  // In pieces, as they arrive over TCP.
  const std::size_t piece = 1 + (flags >> 3);
  for (std::size_t at = 0; at < text.size(); at += piece) {
    const std::size_t count = std::min(piece, text.size() - at);
    client.add({reinterpret_cast<const std::uint8_t*>(text.data() + at), count}, now_ns);
    sweeps.add(spinning::AngleReading{now_ns, 1e-9 * static_cast<double>(at)});
    now_ns += kMs;
    client.look(now_ns);
    client.take_output();
    if (client.take_reconnect()) client.connected(now_ns);
  }
  client.flush();
  while (auto scan = client.take_scan()) {
    check(*scan);
    sweeps.add(std::move(*scan), *client.parameters());
  }
  sweeps.flush();
  DecodedSweep sweep;
  while (sweeps.take(sweep)) check(sweep);
  return 0;
}
