#pragma once
// A simulated scanner that answers like the real one, for tests: takes and returns bytes. Written
// from the protocol's text, separately from the code under test.

#include <cstdint>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

namespace zloam::driver::scip {

inline std::string encoded(std::uint32_t value, int characters) {
  std::string text(static_cast<std::size_t>(characters), '0');
  for (auto c = text.rbegin(); c != text.rend(); ++c, value /= 64) {
    *c = static_cast<char>(value % 64 + 0x30);
  }
  return text;
}

inline std::string summed(const std::string& text) {
  unsigned sum = 0;
  for (const char c : text) sum += static_cast<unsigned char>(c);
  return text + static_cast<char>((sum & 0x3F) + 0x30);
}

inline std::string answer(const std::string& echo, const std::string& status,
                          const std::vector<std::string>& lines = {}) {
  std::string text = echo + "\n" + summed(status) + "\n";
  for (const std::string& line : lines) text += line + "\n";
  return text + "\n";
}

inline std::string told(const std::string& text) { return text + ";" + summed(text).back(); }

struct TestDevice {
  bool measuring = false;
  bool adjusting = false;
  std::string measured;  ///< the command
  std::uint32_t counter_ms = 5000;
  std::vector<std::string> heard;
  /// replaces the answer to a command
  std::string broken_command, broken_answer;
  bool silent = false;
  /// speaks SCIP 1 until SCIP2.0 comes, or for ever
  bool scip1 = false, only_scip1 = false;

  static std::vector<std::string> parameters() {
    return {told("MODL:UTM-30LX-EW"), told("DMIN:23"),   told("DMAX:60000"), told("ARES:1440"),
            told("AMIN:0"),           told("AMAX:1080"), told("AFRT:540"),   told("SCAN:2400")};
  }

  /// One scan of the running command, with all ranges equal.
  std::string scan(std::uint32_t range_mm = 2000) {
    const int first = std::stoi(measured.substr(2, 4));
    const int last = std::stoi(measured.substr(6, 4));
    std::string data;
    for (int step = first; step <= last; ++step) {
      data += encoded(range_mm, 3) + (measured[1] == 'E' ? encoded(100, 3) : "");
    }
    std::vector<std::string> lines = {summed(encoded(counter_ms & 0xFFFFFF, 4))};
    for (std::size_t at = 0; at < data.size(); at += 64) {
      lines.push_back(summed(data.substr(at, 64)));
    }
    return answer(measured, "99", lines);
  }

  /// One scan that was asked for alone.
  std::string single_scan() {
    const std::string running = std::exchange(measured, "GD0180090001");
    std::string reply = scan();
    measured = running;
    return reply.replace(reply.find("\n99b\n"), 5, "\n00P\n");
  }

  std::string respond(const std::string& commands) {
    std::string out;
    std::size_t at = 0;
    while (at < commands.size()) {
      const std::size_t end = commands.find('\n', at);
      out += respond_one(commands.substr(at, end - at));
      at = end + 1;
    }
    return silent ? std::string() : out;
  }

  std::string respond_one(const std::string& command) {
    heard.push_back(command);
    if (command == broken_command) return broken_answer;
    if (scip1) {
      scip1 = only_scip1 || command != "SCIP2.0";
      return command + (scip1 ? "\nE\n\n" : "\n0\n\n");
    }
    if (command == "QT") {
      measuring = false;
      return answer(command, "00");
    }
    if (command == "TM0") return adjusting = true, answer(command, "00");
    if (command == "TM2") {
      const bool was = std::exchange(adjusting, false);
      return answer(command, was ? "00" : "03");
    }
    if (command == "TM1") return answer(command, "00", {summed(encoded(counter_ms, 4))});
    if (command == "VV") return answer(command, "00", {told("VEND:Hokuyo"), told("PROT:SCIP 2.0")});
    if (command == "PP") return answer(command, "00", parameters());
    if (command == "II") return answer(command, "00", {told("STAT:Sensor works well")});
    if (command == "RB") return answer(command, "00");
    if (command[0] == 'M' || command[0] == 'N') {
      measuring = true;
      measured = command;
      return answer(command, "00");
    }
    return answer(command, "0E");
  }
};

}  // namespace zloam::driver::scip
