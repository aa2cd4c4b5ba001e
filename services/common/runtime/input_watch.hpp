#pragma once
// Finds faults of a stage's inputs by their accounts: an input that has gone silent, or whose
// messages are refused. Checked every second; a reason is withdrawn soon after its cause ends.

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "common/runtime/account.hpp"

namespace zloam::runtime {

class InputWatch {
 public:
  struct Input {
    Account account;
    /// good messages that arrived without a request
    std::uint64_t unasked = 0;
    /// messages without a request wait for the worker: it is busy, and the input is not silent
    bool unread = false;
    /// one message per sweep of a live run that continues: messages must keep arriving
    bool expected = false;
  };
  /// By topic, as for Stage::degraded(); an empty reason: the fault is over.
  std::map<std::string, std::string> look(const std::vector<Input>& inputs, std::int64_t now_ns);

 private:
  struct Seen {
    Account last;
    std::uint64_t last_unasked = 0;
    bool known = false;
    std::int64_t first_ns = 0, last_ns = 0;
    std::uint64_t came = 0;
    int looks_since_refusal = 0;
    std::string refusal;
  };
  std::string silence(Seen& seen, const Input& input, std::int64_t now_ns) const;
  std::string refusal(Seen& seen, const Account& now) const;

  std::map<std::string, Seen> seen_;
};

}  // namespace zloam::runtime
