#include "common/runtime/input_watch.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace zloam::runtime {
namespace {

// An input is silent after this many of its own periods, and not before this many seconds.
constexpr double kSilentPeriods = 3.0;
constexpr double kSilent_s = 0.5;
// Messages needed to measure an input's period; from fewer, a slow input would look fast.
constexpr std::uint64_t kEnoughForPeriod = 3;
// Checks (one per second) without a refused message until the fault counts as over.
constexpr int kLooksUntilCalm = 5;

constexpr std::array kRefused = {
    std::pair{Drop::kGarbage, "no messages of this kind, or larger than any of them"},
    std::pair{Drop::kInvalid, "values or numbers that can't be, or another configuration"},
    std::pair{Drop::kTorn,
              "written again before it was read: this stage had no processor for 0.1 s, and its "
              "publisher's zenoh.pool_mib was used up"},
    std::pair{Drop::kWrongRun, "another run: is there a second driver, or a robot of this name?"},
};

std::uint64_t dropped(const Account& account, Drop reason) {
  return account.dropped[static_cast<std::size_t>(reason)];
}

/// Number of messages that were neither duplicates nor refused or fenced.
std::uint64_t useful(const Account& account) {
  std::uint64_t count = account.received - dropped(account, Drop::kDuplicate);
  for (const auto& [reason, why] : kRefused) count -= dropped(account, reason);
  return count - dropped(account, Drop::kFenced);
}

double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

}  // namespace

std::string InputWatch::silence(Seen& seen, const Input& input, std::int64_t now_ns) const {
  const std::uint64_t came = input.unasked - seen.last_unasked;
  if (came > 0 || input.unread) {
    if (seen.came == 0) seen.first_ns = now_ns;
    seen.came += came;
    seen.last_ns = now_ns;
    return {};
  }
  if (!input.expected) seen.came = 0;
  if (seen.came == 0) return {};
  const double period_s = seen.came >= kEnoughForPeriod ? seconds(seen.last_ns - seen.first_ns) /
                                                              static_cast<double>(seen.came)
                                                        : 0.0;
  const double silent_s = seconds(now_ns - seen.last_ns);
  if (silent_s < std::max(kSilent_s, kSilentPeriods * period_s)) return {};
  const std::string lasted = std::to_string(std::lround(std::max(1.0, silent_s))) + " s";
  if (input.account.recovered > seen.last.recovered) {
    return input.account.key + " comes only on request for " + lasted +
           ": its publisher does not send it here; start this stage again if that lasts";
  }
  return "no " + input.account.key + " for " + lasted;
}

std::string InputWatch::refusal(Seen& seen, const Account& now) const {
  const auto more = [&](Drop reason) { return dropped(now, reason) - dropped(seen.last, reason); };
  std::string found;
  for (const auto& [reason, why] : kRefused) {
    if (!seen.known || more(reason) == 0) continue;
    found += (found.empty() ? "" : "; ") + std::to_string(more(reason)) + " messages of " +
             now.key + " refused in a second as " + drop_name(reason) + " (" + why + ")";
  }
  // Duplicates beside new messages are a normal part of recovery; duplicates alone are a fault.
  if (found.empty() && seen.known && more(Drop::kDuplicate) > 0 &&
      useful(now) == useful(seen.last)) {
    found = "nothing but second copies of " + now.key +
            " comes: " + std::to_string(more(Drop::kDuplicate)) + " in a second";
  }
  seen.looks_since_refusal = found.empty() ? seen.looks_since_refusal + 1 : 0;
  if (!found.empty()) seen.refusal = found;
  if (seen.looks_since_refusal >= kLooksUntilCalm) seen.refusal.clear();
  return seen.refusal;
}

std::map<std::string, std::string> InputWatch::look(const std::vector<Input>& inputs,
                                                    std::int64_t now_ns) {
  std::map<std::string, std::string> found;
  for (const Input& input : inputs) {
    Seen& seen = seen_[input.account.key];
    found["silent " + input.account.key] = silence(seen, input, now_ns);
    found["refused " + input.account.key] = refusal(seen, input.account);
    seen.last = input.account;
    seen.last_unasked = input.unasked;
    seen.known = true;
  }
  return found;
}

}  // namespace zloam::runtime
