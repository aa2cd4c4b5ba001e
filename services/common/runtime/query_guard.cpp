#include "common/runtime/query_guard.hpp"

#include "common/messages/build.hpp"
#include "common/messages/keys.hpp"
#include "common/runtime/json_guard.hpp"

namespace zloam::runtime {

bool refused_for_size(zenoh::Query& query) {
  const std::size_t bytes = query.payload().size();
  if (fits(Key::kCommand, bytes)) return false;
  query.reply(query.key(), zenoh::Bytes::own(build(CommandReplyFields{false, too_large(bytes)})),
              encoding_of(Key::kCommand));
  return true;
}

void refuse_as_busy(zenoh::Query& query, std::string_view key) {
  query.reply(key, zenoh::Bytes::own(build(CommandReplyFields{false, kBusy})),
              encoding_of(Key::kCommand));
}

}  // namespace zloam::runtime
