// Parses NMEA sentences, with the fuzzer's checksum and with a corrected one.
#include <cmath>
#include <cstdlib>
#include <string>

#include "driver/decoder/nmea.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace zloam::driver;
  const std::string text(reinterpret_cast<const char*>(data), size);
  parse_rmc(text);
  const std::string body = text.substr(0, text.find('*'));
  int sum = 0;
  for (const char c : body) sum ^= static_cast<unsigned char>(c);
  constexpr const char* kDigits = "0123456789ABCDEF";
  const auto fix = parse_rmc("$" + body + "*" + kDigits[sum >> 4] + kDigits[sum & 15]);
  if (fix && (std::isnan(fix->latitude_deg) || std::isnan(fix->longitude_deg))) std::abort();
  return 0;
}
